//! MobileNetV2 (Sandler et al. 2018), width 1, for inference.
//!
//! [`MobileNetV2::forward`] gives the outputs of torchvision's `features.3`, `.6`, `.13` and `.17`: 24, 32, 96 and 320
//! channels at strides 4, 8, 16 and 32. Cells keep the stride whatever the image's size; [`STEPS`] says where they are.

mod load;

use super::{FeatureMap, SCALES, Steps, normalized};
use crate::error::Result;
use burn::module::{Module, Param};
use burn::tensor::Tensor;
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;

/// Part of cache keys. Raise it when the arithmetic changes.
pub const VERSION: &str = "mobilenetv2-3";

/// Channels after the first convolution.
const STEM: usize = 32;

/// Expansion, output channels and stride of `features.1` to `features.17`.
const BLOCKS: [(usize, usize, usize); 17] = [
    (1, 16, 1),
    (6, 24, 2),
    (6, 24, 1),
    (6, 32, 2),
    (6, 32, 1),
    (6, 32, 1),
    (6, 64, 2),
    (6, 64, 1),
    (6, 64, 1),
    (6, 64, 1),
    (6, 96, 1),
    (6, 96, 1),
    (6, 96, 1),
    (6, 160, 2),
    (6, 160, 1),
    (6, 160, 1),
    (6, 320, 1),
];

/// Blocks, counted from 1, whose outputs are the scales.
const TAPS: [usize; SCALES] = [3, 6, 13, 17];

/// Where the cells of each scale are.
///
/// Padding alone would centre cell `x` on image coordinate `stride * x + 0.5`: output `x` of a 3x3 convolution of stride 2
/// with padding 1 is centred on input `2 x`. Symmetric kernels keep that. Trained kernels of stride 2 lean towards the pixels
/// that padding leaves out: small changes of photos move the maps of the ImageNet weights around these offsets (standard
/// errors 0.1 to 0.8 pixels), near half a stride.
pub const STEPS: [Steps; SCALES] = [
    Steps::new(4.0, 1.9),
    Steps::new(8.0, 3.0),
    Steps::new(16.0, 6.1),
    Steps::new(32.0, 11.6),
];

/// A convolution with its batch normalisation folded in. The padding keeps the size at stride 1.
#[derive(Module, Debug)]
struct Convolution {
    /// `[out, in / groups, kernel, kernel]`.
    weight: Param<Tensor<4>>,
    /// `[out]`.
    bias: Param<Tensor<1>>,
    stride: usize,
}

impl Convolution {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let weight = self.weight.val();
        let [batch, inputs, height, width] = x.dims();
        let [outputs, group, kernel, _] = weight.dims();
        if kernel == 1 {
            // Backends multiply matrices faster than they convolve with 1x1 kernels.
            let product = weight.reshape([1, outputs, inputs]).matmul(x.reshape([
                batch,
                inputs,
                height * width,
            ]));
            let out = product + self.bias.val().reshape([1, outputs, 1]);
            return out.reshape([batch, outputs, height, width]);
        }
        let stride = self.stride;
        let padding = kernel / 2;
        let options = ConvOptions::new([stride; 2], [padding; 2], [1; 2], inputs / group);
        conv2d(x, weight, Some(self.bias.val()), options)
    }
}

/// Inverted residual: expand, convolve each channel, project. The input is added where the shapes agree.
#[derive(Module, Debug)]
struct Block {
    expand: Option<Convolution>,
    depthwise: Convolution,
    project: Convolution,
    residual: bool,
}

impl Block {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let hidden = match &self.expand {
            Some(expand) => relu6(expand.forward(x.clone())),
            None => x.clone(),
        };
        let out = self.project.forward(relu6(self.depthwise.forward(hidden)));
        if self.residual { out + x } else { out }
    }
}

/// MobileNetV2 up to `features.17`.
#[derive(Module, Debug)]
pub struct MobileNetV2 {
    stem: Convolution,
    blocks: Vec<Block>,
}

impl MobileNetV2 {
    /// The four scales of normalised images `[B, 3, H, W]`: `[B, C, ceil(H / s), ceil(W / s)]` with strides s of 4, 8, 16 and
    /// 32. H and W need not be multiples of 32: padding is PyTorch's.
    pub fn forward(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = relu6(self.stem.forward(images));
        let mut scales = Vec::with_capacity(TAPS.len());
        for (n, block) in (1..).zip(&self.blocks) {
            x = block.forward(x);
            if TAPS.contains(&n) {
                scales.push(x.clone());
            }
        }
        scales
    }

    /// The four scales of an image at its own resolution.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for an image without pixels; [`crate::Error::NonFinite`] when an activation is not finite;
    /// [`crate::Error::Device`] when the device fails.
    pub fn maps(&self, image: &image::RgbImage) -> Result<Vec<FeatureMap>> {
        let outputs = self.forward(normalized(image, &self.stem.bias.device())?);
        let outputs = outputs.into_iter().zip(STEPS);
        let maps = (1..).zip(outputs).map(|(n, (cells, steps))| {
            let cells = cells.permute([0, 2, 3, 1]);
            FeatureMap::from_tensor(cells, Some(steps), &format!("MobileNetV2 scale {n}"))
        });
        maps.collect()
    }
}

fn relu6(x: Tensor<4>) -> Tensor<4> {
    x.clamp(0.0, 6.0)
}
