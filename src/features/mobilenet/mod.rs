//! MobileNetV2 (Sandler et al. 2018), width 1, as burn modules for inference.
//!
//! [`MobileNetV2::forward`] gives the outputs of torchvision's `features.3`, `.6`, `.13` and `.17` (24, 32, 96 and 320
//! channels at strides 4, 8, 16 and 32). Their cells keep the stride whatever the image's size; the maps carry
//! where they are, [`STEPS`].

mod fused;
mod load;

pub use self::fused::FoldedNet;

use super::{FeatureMap, SCALES, Steps};
use crate::error::Result;
use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::{Device, Tensor};

/// Part of cache keys; raise it when the arithmetic changes.
pub const VERSION: &str = "mobilenetv2-2";

/// Mean of ImageNet's RGB, 0..1.
pub const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// Standard deviation of ImageNet's RGB.
pub const STD: [f32; 3] = [0.229, 0.224, 0.225];

/// Epsilon of batch normalisation (PyTorch's default).
const EPSILON: f64 = 1e-5;

/// Channels after the first convolution.
const STEM: usize = 32;

/// Expansion, channels out, stride of `features.1` to `features.17`.
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

/// Blocks (numbered from 1) whose outputs are the scales.
const TAPS: [usize; 4] = [3, 6, 13, 17];

/// Where the cells of each scale are.
///
/// By padding alone cell `x` would be centred on image coordinate `stride * x + 0.5` (output `x` of a 3x3 convolution of
/// stride 2 with padding 1 is centred on input `2 x`), and under symmetric kernels it is. Trained kernels of stride 2 are
/// lopsided towards what padding leaves out: small changes of photos move the maps of the ImageNet weights around these
/// offsets, 1.9, 3.0, 6.1 and 11.6 (standard errors 0.1 to 0.8), near half a stride.
pub const STEPS: [Steps; SCALES] = [
    Steps {
        stride: 4.0,
        offset: 1.9,
    },
    Steps {
        stride: 8.0,
        offset: 3.0,
    },
    Steps {
        stride: 16.0,
        offset: 6.1,
    },
    Steps {
        stride: 32.0,
        offset: 11.6,
    },
];

/// Convolution without bias and batch normalisation with running statistics.
#[derive(Module, Debug)]
pub struct ConvNorm {
    conv: Conv2d,
    norm: BatchNorm,
}

impl ConvNorm {
    fn new(
        [input, output]: [usize; 2],
        kernel: usize,
        stride: usize,
        groups: usize,
        device: &Device,
    ) -> Self {
        let pad = kernel / 2;
        let conv = Conv2dConfig::new([input, output], [kernel, kernel])
            .with_stride([stride, stride])
            .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
            .with_groups(groups)
            .with_bias(false);
        Self {
            conv: conv.init(device),
            norm: BatchNormConfig::new(output)
                .with_epsilon(EPSILON)
                .init(device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.norm.forward(self.conv.forward(x))
    }
}

/// Inverted residual: expand, depthwise, project; the input is added where shapes agree.
#[derive(Module, Debug)]
pub struct Block {
    expand: Option<ConvNorm>,
    depthwise: ConvNorm,
    project: ConvNorm,
    residual: bool,
}

impl Block {
    fn new(
        input: usize,
        (expansion, output, stride): (usize, usize, usize),
        device: &Device,
    ) -> Self {
        let hidden = input * expansion;
        Self {
            expand: (expansion > 1).then(|| ConvNorm::new([input, hidden], 1, 1, 1, device)),
            depthwise: ConvNorm::new([hidden, hidden], 3, stride, hidden, device),
            project: ConvNorm::new([hidden, output], 1, 1, 1, device),
            residual: stride == 1 && input == output,
        }
    }

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
    stem: ConvNorm,
    blocks: Vec<Block>,
}

impl MobileNetV2 {
    /// With random weights.
    fn new(device: &Device) -> Self {
        let mut input = STEM;
        let blocks = BLOCKS.map(|shape| {
            let block = Block::new(input, shape, device);
            input = shape.1;
            block
        });
        Self {
            stem: ConvNorm::new([3, STEM], 3, 2, 1, device),
            blocks: blocks.into(),
        }
    }

    /// The four scales of normalised images `[B, 3, H, W]` (see [`MEAN`], [`STD`]): `[B, C, ceil(H / s), ceil(W / s)]`
    /// with strides s of 4, 8, 16, 32. H and W need not be multiples of 32: padding is PyTorch's.
    pub fn forward(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = relu6(self.stem.forward(images));
        let mut scales = Vec::with_capacity(TAPS.len());
        for (n, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            if TAPS.contains(&(n + 1)) {
                scales.push(x.clone());
            }
        }
        scales
    }
}

impl FoldedNet {
    /// The four scales of an image at its own resolution; normalised here.
    ///
    /// # Errors
    /// As [`FoldedNet::forward`].
    pub fn maps(&self, image: &image::RgbImage) -> Result<[FeatureMap; SCALES]> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut planes = Vec::with_capacity(3 * width * height);
        for (c, (mean, std)) in MEAN.iter().zip(STD).enumerate() {
            let channel = image.as_raw().iter().skip(c).step_by(3);
            planes.extend(channel.map(|&x| (f32::from(x) / 255.0 - mean) / std));
        }
        self.forward(planes, height, width)
    }
}

fn relu6(x: Tensor<4>) -> Tensor<4> {
    x.clamp(0.0, 6.0)
}
