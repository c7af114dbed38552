//! The decoder (Eq. 7): image and spatial features fused from global to local into one identity a Gaussian.
//!
//! Only its parameters are learned. The linear map of a concatenation is the sum of the maps of its parts, and a linear
//! map may be applied before upsampling, US(x) W = US(x W), on a quarter of the rows: what comes up from below is never
//! put beside the frozen features.

use super::pyramid::{Pyramid, Restriction};
use super::randla::{SLOPE, parameter};
use crate::ops::{LayerMap, dense, fusion_layer};
use burn::config::Config;
use burn::module::{Module, Param};
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor, TensorData};
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
    /// Channels of f_d,n and f_s,n together at each scale that is read, finest first.
    pub features: Vec<usize>,
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
        let scales = if multi_scale {
            pyramid.levels.len().min(WIDTHS.len())
        } else {
            1.min(pyramid.levels.len())
        };
        let levels = &pyramid.levels[..scales];
        let top = if multi_scale {
            pyramid.top.dims()[1]
        } else {
            0
        };
        Self::new(
            levels.iter().map(|l| l.features.dims()[1]).collect(),
            top,
            classes,
        )
    }

    /// A decoder with seeded first weights, uniform in +-1/sqrt(inputs of the layer).
    pub fn init(&self, device: &Device) -> Decoder {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(INIT_STREAM);
        let scales = self.features.len().min(WIDTHS.len());
        let layers = (0..scales).map(|n| {
            let (width, below) = (
                WIDTHS[n],
                if n + 1 < scales {
                    WIDTHS[n + 1]
                } else {
                    self.top
                },
            );
            let bound = bound(self.features[n] + below);
            let mut map = |inputs: usize| {
                (inputs > 0).then(|| {
                    parameter(
                        uniform(inputs * width, bound, &mut rng),
                        [inputs, width],
                        device,
                    )
                })
            };
            FusionLayer {
                features: map(self.features[n]),
                below: map(below),
                bias: parameter(uniform(width, bound, &mut rng), [width], device),
                norm: self
                    .layer_norm
                    .then(|| LayerNormConfig::new(width).init(device)),
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
    (0..count)
        .map(|_| bound * rng.random_range(-1.0f32..1.0))
        .collect()
}

/// Shared MLP over the frozen features of a level and what comes up from below.
#[derive(Module, Debug)]
struct FusionLayer {
    features: Option<Param<Tensor<2>>>,
    below: Option<Param<Tensor<2>>>,
    bias: Param<Tensor<1>>,
    norm: Option<LayerNorm>,
}

impl FusionLayer {
    /// `features` are the frozen rows of the level, each channel times its factor in `channels` where there are any;
    /// `below` is what comes up from the next coarser one, before upsampling.
    fn forward(
        &self,
        features: Tensor<2>,
        channels: &[f32],
        below: Tensor<2>,
        mut map: LayerMap,
    ) -> Tensor<2> {
        let (bias, device) = (self.bias.val(), features.device());
        let width = bias.dims()[0];
        let weight = match &self.features {
            // (x diag(f)) W = x (diag(f) W)
            Some(weight) if !channels.is_empty() => {
                let factors = TensorData::new(channels.to_vec(), [channels.len(), 1]);
                weight.val() * Tensor::from_data(factors, &device)
            }
            Some(weight) => weight.val(),
            None => Tensor::zeros([features.dims()[1], width], &device),
        };
        let below = match &self.below {
            Some(weight) => dense(below, weight.val(), None),
            None => Tensor::zeros([map.upsample.columns, width], &device),
        };
        let Some(norm) = &self.norm else {
            return fusion_layer(features, weight, below, bias, map);
        };
        map.slope = 1.0;
        leaky_relu(
            norm.forward(fusion_layer(features, weight, below, bias, map)),
            SLOPE,
        )
    }
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
    /// Decodes the kept part of `pyramid` from global to local: row `i` of what comes out at a scale belongs to the
    /// `i`-th kept row of that level. Gradients flow to the parameters, and to features that track them.
    ///
    /// # Panics
    /// If `pyramid` has fewer levels or other widths than the decoder was made for, or `kept` is of another pyramid.
    pub fn forward(&self, pyramid: &Pyramid, kept: &Restriction) -> Decoded {
        self.forward_scaled(pyramid, kept, &[])
    }

    /// [`Decoder::forward`] of frozen features whose channels are first multiplied by `factors`, one list a scale, empty
    /// for none: dropout is a list of zeros and 1 / (1 - rate).
    ///
    /// # Panics
    /// As [`Decoder::forward`]; if a list is not as long as its scale has channels.
    pub fn forward_scaled(
        &self,
        pyramid: &Pyramid,
        kept: &Restriction,
        factors: &[Vec<f32>],
    ) -> Decoded {
        let (hidden, fused) = self.decode(pyramid, kept, factors, 0);
        Decoded { hidden, fused }
    }

    /// [`Decoded::fused`] of the scales from `finest` (zero-based) on alone, what Eq. 9 needs: finer ones are not decoded.
    /// `factors` as in [`Decoder::forward_scaled`].
    ///
    /// # Panics
    /// As [`Decoder::forward_scaled`].
    pub fn fused(
        &self,
        pyramid: &Pyramid,
        kept: &Restriction,
        factors: &[Vec<f32>],
        finest: usize,
    ) -> Vec<Tensor<2>> {
        self.decode(pyramid, kept, factors, finest).1
    }

    fn decode(
        &self,
        pyramid: &Pyramid,
        kept: &Restriction,
        factors: &[Vec<f32>],
        finest: usize,
    ) -> (Tensor<2>, Vec<Tensor<2>>) {
        let device = self.last.weight.device();
        assert!(
            self.layers.len() <= pyramid.levels.len(),
            "levels of the pyramid against layers of the decoder"
        );
        let mut below = tracked(&kept.of_top(&pyramid.top), &device);
        let mut fused = Vec::with_capacity(self.layers.len());
        for (n, (layer, level)) in self
            .layers
            .iter()
            .zip(&pyramid.levels)
            .enumerate()
            .skip(finest)
            .rev()
        {
            let map = LayerMap {
                rows: kept.rows(n).cloned(),
                upsample: kept.upsample(n).clone(),
                slope: SLOPE,
            };
            let channels = factors.get(n).map_or(&[][..], |f| f);
            below = layer.forward(tracked(&level.features, &device), channels, below, map);
            fused.push(below.clone());
        }
        fused.reverse();
        (below, fused)
    }

    /// Logits `[rows, C]` of hidden features `[rows, 64]`, of Gaussians or of pixels.
    ///
    /// The FC commutes with blending: of hidden features blended with weights that sum to 1 - T, the blended logits are
    /// `blended W + (1 - T) b`. Divided by 1 - T, as the label loss wants them, they are `classify(blended / (1 - T))`.
    pub fn classify(&self, hidden: Tensor<2>) -> Tensor<2> {
        dense(
            hidden,
            self.last.weight.val(),
            self.last.bias.as_ref().map(Param::val),
        )
    }

    /// The decoder with its last layer at zero: it says nothing until it has learned.
    #[must_use]
    pub fn with_silent_start(mut self) -> Self {
        let silent =
            |tensor: Tensor<2>| Tensor::from_inner(tensor.inner().zeros_like()).require_grad();
        self.last.weight = self.last.weight.map(silent);
        self.last.bias = self
            .last
            .bias
            .map(|b| b.map(|t| Tensor::from_inner(t.inner().zeros_like()).require_grad()));
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
