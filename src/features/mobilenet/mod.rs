//! MobileNetV2 (Sandler et al. 2018), width 1, as burn modules for inference.
//!
//! [`MobileNetV2::forward`] gives the outputs of torchvision's `features.3`, `.6`, `.13` and `.17` (24, 32, 96 and 320
//! channels at strides 4, 8, 16 and 32).

mod load;

use super::{FeatureMap, SCALES};
use crate::error::Result;
use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::{Device, Tensor, TensorData};

/// Part of cache keys; raise it when the arithmetic changes.
pub const VERSION: &str = "mobilenetv2-1";

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

/// Convolution without bias and batch normalisation with running statistics.
#[derive(Module, Debug)]
pub struct ConvNorm {
    conv: Conv2d,
    norm: BatchNorm,
}

impl ConvNorm {
    fn new([input, output]: [usize; 2], kernel: usize, stride: usize, groups: usize, device: &Device) -> Self {
        let pad = kernel / 2;
        let conv = Conv2dConfig::new([input, output], [kernel, kernel])
            .with_stride([stride, stride])
            .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
            .with_groups(groups)
            .with_bias(false);
        Self { conv: conv.init(device), norm: BatchNormConfig::new(output).with_epsilon(EPSILON).init(device) }
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
    fn new(input: usize, (expansion, output, stride): (usize, usize, usize), device: &Device) -> Self {
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
        Self { stem: ConvNorm::new([3, STEM], 3, 2, 1, device), blocks: blocks.into() }
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

impl MobileNetV2 {
    /// The four scales of an image, normalised here, at image resolution.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when an activation is not finite.
    pub fn maps(&self, image: &image::RgbImage) -> Result<[FeatureMap; SCALES]> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut planes = vec![0.0; 3 * width * height];
        for (c, plane) in planes.chunks_exact_mut((width * height).max(1)).enumerate() {
            for (o, pixel) in plane.iter_mut().zip(image.as_raw().chunks_exact(3)) {
                *o = (f32::from(pixel[c]) / 255.0 - MEAN[c]) / STD[c];
            }
        }
        let device = self.stem.conv.weight.device();
        let input = Tensor::from_data(TensorData::new(planes, [1, 3, height, width]), &device);
        let mut maps: [FeatureMap; SCALES] = Default::default();
        for (n, (map, x)) in maps.iter_mut().zip(self.forward(input)).enumerate() {
            let [_, channels, height, width] = x.dims();
            let data = x.permute([0, 2, 3, 1]).into_data().into_vec::<f32>().unwrap_or_default();
            *map = FeatureMap { height, width, channels, data };
            map.check(&format!("MobileNetV2 scale {}", n + 1))?;
        }
        Ok(maps)
    }
}

fn relu6(x: Tensor<4>) -> Tensor<4> {
    x.clamp(0.0, 6.0)
}
