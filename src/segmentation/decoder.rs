//! The decoder (Eq. 7): image and spatial features fused from global to local into one identity a Gaussian.
//!
//! Only its parameters are learned. The linear map of a concatenation is the sum of the maps of its parts, and a linear
//! map may be applied before upsampling, US(x) W = US(x W), on a quarter of the rows: nothing is concatenated.

use super::pyramid::Pyramid;
use super::randla::{SLOPE, parameter};
use crate::ops::sparse_apply;
use burn::config::Config;
use burn::module::Module;
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Widths of the shared MLPs at scales 1 to 4.
pub const WIDTHS: [usize; 4] = [64, 64, 128, 256];
/// Channels of the hidden features that are blended; the last FC maps them to classes.
pub const HIDDEN: usize = WIDTHS[0];
/// Purpose of the random stream of the first weights.
const INIT_STREAM: u64 = 0x6465_636f;

/// Shape of a [`Decoder`].
#[derive(Config, Debug)]
pub struct DecoderConfig {
    /// Channels of f_d,n at each scale that is read, finest first; 0 where image features are off.
    pub image: Vec<usize>,
    /// Channels of f_s,n at those scales; 0 where spatial features are off.
    pub spatial: Vec<usize>,
    /// Channels of f_e; 0 where nothing is read from below the last scale.
    pub top: usize,
    /// Classes.
    pub classes: usize,
    /// Whether LayerNorm follows each linear map.
    #[config(default = false)]
    pub layer_norm: bool,
    /// Seed of the first weights.
    #[config(default = 0)]
    pub seed: u64,
}

impl DecoderConfig {
    /// The decoder that reads `pyramid`, or only its finest level (`multi_scale = false`).
    pub fn for_pyramid(pyramid: &Pyramid, classes: usize, multi_scale: bool) -> Self {
        let scales = if multi_scale { pyramid.levels.len().min(WIDTHS.len()) } else { 1.min(pyramid.levels.len()) };
        let levels = &pyramid.levels[..scales];
        let widths = |of: fn(&super::pyramid::Level) -> &Tensor<2>| levels.iter().map(|l| of(l).dims()[1]).collect();
        let top = if multi_scale { pyramid.top.dims()[1] } else { 0 };
        Self::new(widths(|l| &l.image), widths(|l| &l.spatial), top, classes)
    }

    /// A decoder with seeded first weights, uniform in +-1/sqrt(inputs of the layer).
    pub fn init(&self, device: &Device) -> Decoder {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(INIT_STREAM);
        let scales = self.image.len().min(self.spatial.len()).min(WIDTHS.len());
        let layers = (0..scales).map(|n| {
            let (width, below) = (WIDTHS[n], if n + 1 < scales { WIDTHS[n + 1] } else { self.top });
            let bound = bound(self.image[n] + self.spatial[n] + below);
            let mut map = |inputs: usize| {
                let weight = parameter(uniform(inputs * width, bound, &mut rng), [inputs, width], device);
                (inputs > 0).then_some(Linear { weight, bias: None })
            };
            FusionLayer {
                image: map(self.image[n]),
                spatial: map(self.spatial[n]),
                below: map(below),
                bias: parameter(uniform(width, bound, &mut rng), [width], device),
                norm: self.layer_norm.then(|| LayerNormConfig::new(width).init(device)),
            }
        });
        let layers = layers.collect();
        let weight = uniform(HIDDEN * self.classes, bound(HIDDEN), &mut rng);
        let bias = uniform(self.classes, bound(HIDDEN), &mut rng);
        let last = Linear {
            weight: parameter(weight, [HIDDEN, self.classes], device),
            bias: Some(parameter(bias, [self.classes], device)),
        };
        Decoder { layers, last }
    }
}

fn bound(inputs: usize) -> f32 {
    1.0 / (inputs.max(1) as f32).sqrt()
}

fn uniform(count: usize, bound: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..count).map(|_| bound * rng.random_range(-1.0f32..1.0)).collect()
}

/// Shared MLP over the frozen features of a level and what comes up from below.
#[derive(Module, Debug)]
struct FusionLayer {
    image: Option<Linear>,
    spatial: Option<Linear>,
    below: Option<Linear>,
    bias: burn::module::Param<Tensor<1>>,
    norm: Option<LayerNorm>,
}

/// What one decoding gives.
#[derive(Clone, Debug)]
pub struct Decoded {
    /// `[N_1, 64]`: blend these, then [`Decoder::classify`] per pixel.
    pub hidden: Tensor<2>,
    /// Fused features of every scale that is read, finest first, `[N_n, width]`: what Eq. 9 reads at n = 3, 4.
    pub fused: Vec<Tensor<2>>,
}

/// The decoder: a shared MLP a scale (LeakyReLU 0.2), and a last FC.
#[derive(Module, Debug)]
pub struct Decoder {
    layers: Vec<FusionLayer>,
    last: Linear,
}

impl Decoder {
    /// Decodes from global to local. Gradients flow to the parameters only.
    ///
    /// # Panics
    /// If `pyramid` has fewer levels or other widths than the decoder was made for.
    pub fn forward(&self, pyramid: &Pyramid) -> Decoded {
        let device = self.last.weight.device();
        assert!(self.layers.len() <= pyramid.levels.len(), "levels of the pyramid against layers of the decoder");
        let mut below = tracked(&pyramid.top, &device);
        let mut fused = Vec::with_capacity(self.layers.len());
        for (layer, level) in self.layers.iter().zip(&pyramid.levels).rev() {
            let image = layer.image.as_ref().map(|map| map.forward(tracked(&level.image, &device)));
            let spatial = layer.spatial.as_ref().map(|map| map.forward(tracked(&level.spatial, &device)));
            let below_map = layer.below.as_ref();
            let upsampled = below_map.map(|map| sparse_apply(map.forward(below.clone()), level.upsample.clone()));
            let bias = layer.bias.val().unsqueeze();
            let sum = [image, spatial, upsampled].into_iter().flatten().reduce(|a, b| a + b);
            let x = match sum {
                Some(sum) => sum + bias,
                None => bias.expand([level.points.len() as i64, -1]), // all features off: a constant
            };
            let x = match &layer.norm {
                Some(norm) => norm.forward(x),
                None => x,
            };
            below = leaky_relu(x, SLOPE);
            fused.push(below.clone());
        }
        fused.reverse();
        Decoded { hidden: below, fused }
    }

    /// Logits `[rows, C]` of hidden features `[rows, 64]`, of Gaussians or of pixels.
    ///
    /// The FC commutes with blending: of hidden features blended with weights that sum to 1 - T, the blended logits are
    /// `blended W + (1 - T) b`. Divided by 1 - T, as the label loss wants them, they are `classify(blended / (1 - T))`.
    pub fn classify(&self, hidden: Tensor<2>) -> Tensor<2> {
        self.last.forward(hidden)
    }

    /// The decoder with its last layer at zero: it says nothing until it has learned.
    #[must_use]
    pub fn with_silent_start(mut self) -> Self {
        let silent = |tensor: Tensor<2>| Tensor::from_inner(tensor.inner().zeros_like()).require_grad();
        self.last.weight = self.last.weight.map(silent);
        self.last.bias = self.last.bias.map(|b| b.map(|t| Tensor::from_inner(t.inner().zeros_like()).require_grad()));
        self
    }

    /// Bytes of the learned parameters; [`Module::num_params`] counts them.
    pub fn bytes(&self) -> usize {
        4 * self.num_params()
    }
}

/// A frozen tensor beside parameters on `device`, with or without autodiff.
fn tracked(frozen: &Tensor<2>, device: &Device) -> Tensor<2> {
    match device.is_autodiff() && !frozen.device().is_autodiff() {
        true => Tensor::from_inner(frozen.clone()),
        false => frozen.clone(),
    }
}
