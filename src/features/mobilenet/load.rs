//! MobileNetV2 weights from `.safetensors` or PyTorch files.
//!
//! Two layouts of keys are published: torchvision's nested one (`features.2.conv.0.0.weight`) and a flat one
//! (`features.2.conv.0.weight`).

use super::{BLOCKS, Block, Convolution, MobileNetV2, STEM};
use crate::backend::device::upload;
use crate::error::Result;
use crate::weights::WeightFile;
use burn::module::Param;
use burn::tensor::Device;
use std::path::Path;

/// Epsilon of batch normalisation: PyTorch's default.
const EPSILON: f64 = 1e-5;

const NETWORK: &str = "MobileNetV2 of width 1 (keys `features.0.*` to `features.17.*`)";

impl MobileNetV2 {
    /// Reads weights from a `.safetensors` file, or from any other file as a PyTorch checkpoint. The classifier and
    /// `features.18` are not used.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file cannot be opened; [`crate::Error::Input`] when it is damaged, when tensors are missing, have
    /// other shapes, hold a value that is not finite, or belong to blocks that this network does not have.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        let mut weights = Weights::open(path, device)?;
        let stem = weights.convolution("0.0", "0.1", [STEM, 3, 3], 2)?;
        let mut input = STEM;
        let mut blocks = Vec::with_capacity(BLOCKS.len());
        for (n, &(expansion, output, stride)) in (1..).zip(&BLOCKS) {
            let hidden = input * expansion;
            let expand = match expansion {
                1 => None,
                _ => Some(weights.layer(n, 0, false, [hidden, input, 1], 1)?),
            };
            let next = usize::from(expand.is_some());
            blocks.push(Block {
                expand,
                depthwise: weights.layer(n, next, false, [hidden, 1, 3], stride)?,
                project: weights.layer(n, next + 1, true, [output, hidden, 1], 1)?,
                residual: stride == 1 && input == output,
            });
            input = output;
        }
        weights.check_unused()?;
        Ok(Self { stem, blocks })
    }
}

/// The tensors of a file that no layer has taken yet.
struct Weights<'a> {
    file: WeightFile,
    /// Whether keys are torchvision's.
    nested: bool,
    device: &'a Device,
}

impl<'a> Weights<'a> {
    fn open(path: &Path, device: &'a Device) -> Result<Self> {
        let file = WeightFile::open(path)?.of_network(NETWORK);
        // `features.` and its parents, such as `module.`.
        let parents = |key: &String| Some(key.strip_suffix("0.0.weight")?.to_owned());
        let mut prefixes = file.tensors.keys().filter_map(parents);
        let prefix = prefixes.find(|prefix| prefix.ends_with("features."));
        let file = file.under(&prefix.unwrap_or_else(|| "features.".into()));
        Ok(Self {
            nested: file.tensors.contains_key("1.conv.0.0.weight"),
            file,
            device,
        })
    }

    /// Layer `place` of block `block`, both as torchvision counts. The last layer of a block has no activation, and its keys
    /// are not nested.
    fn layer(
        &mut self,
        block: usize,
        place: usize,
        last: bool,
        shape: [usize; 3],
        stride: usize,
    ) -> Result<Convolution> {
        let [conv, norm] = if !self.nested {
            // Convolution, normalisation and activation are counted one by one.
            [(3 * place).to_string(), (3 * place + 1).to_string()]
        } else if last {
            [place.to_string(), (place + 1).to_string()]
        } else {
            [format!("{place}.0"), format!("{place}.1")]
        };
        let key = |part: String| format!("{block}.conv.{part}");
        self.convolution(&key(conv), &key(norm), shape, stride)
    }

    /// The convolution of shape `[out, in / groups, kernel, kernel]` under the key `conv`, with the batch normalisation under
    /// `norm` folded in.
    fn convolution(
        &mut self,
        conv: &str,
        norm: &str,
        [outputs, group, kernel]: [usize; 3],
        stride: usize,
    ) -> Result<Convolution> {
        let shape = [outputs, group, kernel, kernel];
        let weight = self.take(&format!("{conv}.weight"), &shape)?;
        let gamma = self.take(&format!("{norm}.weight"), &[outputs])?;
        let beta = self.take(&format!("{norm}.bias"), &[outputs])?;
        let mean = self.take(&format!("{norm}.running_mean"), &[outputs])?;
        let variance_name = format!("{norm}.running_var");
        let variance = self.take(&variance_name, &[outputs])?;
        if let Some(negative) = variance.iter().find(|v| **v < 0.0) {
            let found = negative.to_string();
            return Err(self.file.problem(&variance_name, found, "none negative"));
        }
        let scale: Vec<f64> = gamma
            .iter()
            .zip(&variance)
            .map(|(&gamma, &variance)| f64::from(gamma) / (f64::from(variance) + EPSILON).sqrt())
            .collect();
        let taps = group * kernel * kernel;
        let weight: Vec<f32> = weight
            .chunks(taps)
            .zip(&scale)
            .flat_map(|(row, scale)| row.iter().map(move |&w| (f64::from(w) * scale) as f32))
            .collect();
        let bias: Vec<f32> = (0..outputs)
            .map(|c| (f64::from(beta[c]) - f64::from(mean[c]) * scale[c]) as f32)
            .collect();
        Ok(Convolution {
            weight: Param::from_tensor(upload(weight, shape, self.device)),
            bias: Param::from_tensor(upload(bias, [outputs], self.device)),
            stride,
        })
    }

    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let values = self.file.get(name, shape)?.to_vec();
        self.file.tensors.remove(name);
        Ok(values)
    }

    /// Refuses tensors of further layers: they belong to another network.
    fn check_unused(&self) -> Result<()> {
        let is_further =
            |name: &&String| !name.starts_with("18.") && !name.ends_with("num_batches_tracked");
        match self.file.tensors.keys().find(is_further) {
            Some(name) => Err(self.file.problem(name, "this tensor", "none of this name")),
            None => Ok(()),
        }
    }
}
