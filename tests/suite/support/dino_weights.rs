//! Weights of DINO's ViT in any size, generated.

use safetensors::tensor::{Dtype, TensorView};
use std::collections::BTreeMap;
use std::path::Path;

/// Shape and values of each tensor.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Dimensions of a network.
#[derive(Clone, Copy)]
pub struct Size {
    pub width: usize,
    pub patch: usize,
    pub depth: usize,
    pub side: usize,
    pub hidden: usize,
}

/// Tensors with the names and shapes of the official code; values from a hash of name and place, the size of trained ones.
pub fn generated(size: Size) -> Tensors {
    let Size {
        width: d,
        patch,
        depth,
        side,
        hidden,
    } = size;
    let mut shapes: Vec<(String, Vec<usize>)> = vec![
        ("cls_token".into(), vec![1, 1, d]),
        ("pos_embed".into(), vec![1, 1 + side * side, d]),
        ("patch_embed.proj.weight".into(), vec![d, 3, patch, patch]),
        ("patch_embed.proj.bias".into(), vec![d]),
    ];
    let mut layer = |name: String, weight: Vec<usize>| {
        shapes.push((format!("{name}.bias"), vec![weight[0]]));
        shapes.push((format!("{name}.weight"), weight));
    };
    for n in 0..depth {
        layer(format!("blocks.{n}.norm1"), vec![d]);
        layer(format!("blocks.{n}.attn.qkv"), vec![3 * d, d]);
        layer(format!("blocks.{n}.attn.proj"), vec![d, d]);
        layer(format!("blocks.{n}.norm2"), vec![d]);
        layer(format!("blocks.{n}.mlp.fc1"), vec![hidden, d]);
        layer(format!("blocks.{n}.mlp.fc2"), vec![d, hidden]);
    }
    layer("norm".into(), vec![d]);
    let tensors = shapes.into_iter().map(|(name, shape)| {
        let mut state = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3)
        });
        let fan: usize = shape[1..].iter().product();
        let norm = name.contains("norm") && name.ends_with("weight");
        let (mean, spread) = if norm {
            (1.0, 0.3)
        } else {
            (0.0, 2.0 / (fan as f32).sqrt().clamp(4.0, 40.0))
        };
        let values = (0..shape.iter().product()).map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            mean + spread * ((state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0)
        });
        (name, (shape.clone(), values.collect()))
    });
    tensors.collect()
}

/// Writes a safetensors file.
pub fn write(path: &Path, tensors: &Tensors) {
    let bytes: Vec<Vec<u8>> = tensors
        .values()
        .map(|(_, v)| v.iter().flat_map(|x| x.to_le_bytes()).collect())
        .collect();
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, (shape, _)), bytes)| {
            (
                name.clone(),
                TensorView::new(Dtype::F32, shape.clone(), bytes).expect("a tensor"),
            )
        });
    std::fs::write(
        path,
        safetensors::serialize(views, None).expect("serialize"),
    )
    .expect("write");
}
