//! A small ONNX segmenter: one convolution that tells colours apart. The file is written field by field, so that tests can
//! spoil any of them.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Side of a cell, pixels.
pub const STRIDE: usize = 4;
/// The classes of the network.
pub const NAMES: [&str; 5] = ["nothing", "crimson", "lime", "navy", "plaster"];

/// The plates and a network that tells their colours apart.
pub fn plates() -> (TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path().join("scene");
    std::fs::create_dir(&dir).expect("scene");
    scene(&dir);
    let model = Onnx::write_sound(folder.path(), WIDTH, HEIGHT);
    (folder, dir, model)
}

/// What the file says; the default is sound.
pub struct Onnx {
    pub input: (&'static str, Vec<u64>),
    pub output: (&'static str, Vec<u64>),
    /// Name of the tensor that the convolution makes.
    pub made: &'static str,
    pub operator: &'static str,
    /// Domain of the operator.
    pub domain: &'static str,
    /// Type of the input, a number of ONNX's; 1 is float32.
    pub input_type: u64,
    /// Operators after the convolution, as [`node`] makes them.
    pub nodes: Vec<Vec<u8>>,
    /// `[classes, 3, stride, stride]`
    pub weights_shape: Vec<u64>,
    /// Bytes that the weights lack.
    pub missing: usize,
    pub external: bool,
    /// One number for each class.
    pub bias: [f32; 5],
}

impl Onnx {
    /// For an input of this width and height.
    pub fn new(width: usize, height: usize) -> Self {
        let side = STRIDE as u64;
        let (w, h) = (width as u64, height as u64);
        Self {
            input: ("image", vec![1, 3, h, w]),
            output: ("logits", vec![1, NAMES.len() as u64, h / side, w / side]),
            made: "logits",
            operator: "Conv",
            domain: "",
            input_type: 1,
            nodes: vec![],
            weights_shape: vec![NAMES.len() as u64, 3, side, side],
            missing: 0,
            external: false,
            bias: [24.0, 0.0, 0.0, 0.0, 18.0],
        }
    }

    /// The contract of the file.
    pub fn contract(width: usize, height: usize) -> String {
        format!(
            "[input]\ntensor = \"image\"\nlayout = \"nchw\"\nsize = [{width}, {height}]\nresize = \"stretch\"\nmean = [0.0, 0.0, 0.0]\n\
             std = [255.0, 255.0, 255.0]\n[output]\ntensor = \"logits\"\nlayout = \"nchw\"\nstride = {STRIDE}\nalignment = \"half_pixel\"\n\
             values = \"logits\"\nnone = 0\n[classes]\nnames = {NAMES:?}\n"
        )
    }

    /// Writes `net.onnx` and its contract into `dir`, for photos of this size.
    pub fn write_sound(dir: &Path, width: usize, height: usize) -> std::path::PathBuf {
        let file = dir.join("net.onnx");
        std::fs::write(&file, Self::new(width, height).bytes()).unwrap();
        std::fs::write(dir.join("net.toml"), Self::contract(width, height)).unwrap();
        file
    }

    /// The file: mean colours of cells times a matrix, plus a bias.
    pub fn bytes(&self) -> Vec<u8> {
        // Each plate has a strong channel; the wall is grey and light, nothing is dark.
        let matrix = [
            [-30.0, -30.0, -30.0],
            [40.0, -20.0, -20.0],
            [-20.0, 40.0, -20.0],
            [-20.0, -20.0, 40.0],
            [0.0, 0.0, 0.0],
        ];
        let cell = STRIDE * STRIDE;
        let weights = matrix
            .iter()
            .flat_map(|row| row.iter().flat_map(|w: &f32| vec![w / cell as f32; cell]));
        let mut raw: Vec<u8> = weights.flat_map(f32::to_le_bytes).collect();
        raw.truncate(raw.len() - self.missing);
        let mut weights = vec![];
        self.weights_shape
            .iter()
            .for_each(|side| number(&mut weights, 1, *side));
        number(&mut weights, 2, 1);
        text(&mut weights, 8, "weights");
        if self.external {
            let mut entry = vec![];
            text(&mut entry, 1, "location");
            text(&mut entry, 2, "../secret");
            bytes(&mut weights, 13, &entry);
            number(&mut weights, 14, 1);
        } else {
            bytes(&mut weights, 9, &raw);
        }
        let mut biases = vec![];
        number(&mut biases, 1, self.bias.len() as u64);
        number(&mut biases, 2, 1);
        text(&mut biases, 8, "bias");
        bytes(
            &mut biases,
            9,
            &self
                .bias
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect::<Vec<_>>(),
        );

        let mut node = vec![];
        ["image", "weights", "bias"]
            .iter()
            .for_each(|name| text(&mut node, 1, name));
        text(&mut node, 2, self.made);
        text(&mut node, 3, "head");
        text(&mut node, 4, self.operator);
        text(&mut node, 7, self.domain);
        for name in ["kernel_shape", "strides"] {
            let mut attribute = vec![];
            text(&mut attribute, 1, name);
            [STRIDE, STRIDE]
                .iter()
                .for_each(|side| number(&mut attribute, 8, *side as u64));
            number(&mut attribute, 20, 7);
            bytes(&mut node, 5, &attribute);
        }
        let mut graph = vec![];
        bytes(&mut graph, 1, &node);
        self.nodes
            .iter()
            .for_each(|node| bytes(&mut graph, 1, node));
        text(&mut graph, 2, "graph");
        bytes(&mut graph, 5, &weights);
        bytes(&mut graph, 5, &biases);
        bytes(&mut graph, 11, &value(&self.input, self.input_type));
        bytes(&mut graph, 12, &value(&self.output, 1));
        let mut opset = vec![];
        number(&mut opset, 2, 13);
        let mut model = vec![];
        number(&mut model, 1, 7);
        bytes(&mut model, 7, &graph);
        bytes(&mut model, 8, &opset);
        model
    }
}

/// An operator, with attributes as [`flag`] and [`graph`] make them.
pub fn node(operator: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
    let mut node = vec![];
    inputs.iter().for_each(|name| text(&mut node, 1, name));
    text(&mut node, 2, output);
    text(&mut node, 3, &format!("make {output}"));
    text(&mut node, 4, operator);
    for attribute in attributes {
        bytes(&mut node, 5, attribute);
    }
    node
}

/// An attribute that is a graph of these operators.
pub fn graph(name: &str, nodes: &[Vec<u8>]) -> Vec<u8> {
    let mut graph = vec![];
    nodes.iter().for_each(|node| bytes(&mut graph, 1, node));
    text(&mut graph, 2, name);
    let mut attribute = vec![];
    text(&mut attribute, 1, name);
    bytes(&mut attribute, 6, &graph);
    number(&mut attribute, 20, 5);
    attribute
}

/// An attribute that is a whole number.
pub fn flag(name: &str, value: u64) -> Vec<u8> {
    let mut attribute = vec![];
    text(&mut attribute, 1, name);
    number(&mut attribute, 3, value);
    number(&mut attribute, 20, 2);
    attribute
}

/// Name, type and shape of an input or output.
fn value((name, shape): &(&str, Vec<u64>), kind: u64) -> Vec<u8> {
    let mut sides = vec![];
    for side in shape {
        let mut dimension = vec![];
        number(&mut dimension, 1, *side);
        bytes(&mut sides, 1, &dimension);
    }
    let mut tensor = vec![];
    number(&mut tensor, 1, kind);
    bytes(&mut tensor, 2, &sides);
    let mut kind = vec![];
    bytes(&mut kind, 1, &tensor);
    let mut value = vec![];
    text(&mut value, 1, name);
    bytes(&mut value, 2, &kind);
    value
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn number(out: &mut Vec<u8>, field: u64, value: u64) {
    varint(out, field << 3);
    varint(out, value);
}

fn bytes(out: &mut Vec<u8>, field: u64, content: &[u8]) {
    varint(out, field << 3 | 2);
    varint(out, content.len() as u64);
    out.extend_from_slice(content);
}

fn text(out: &mut Vec<u8>, field: u64, content: &str) {
    bytes(out, field, content.as_bytes());
}
