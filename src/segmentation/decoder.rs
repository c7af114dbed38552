//! The decoder (Eq. 7) fuses image and spatial features from global to local into one identity for each Gaussian.
//!
//! Only its parameters are learned. Linear maps are applied before upsampling, on a quarter of the rows.

use super::linear::{add_bias, bound, leaky_relu, linear, parameter, product};
use super::pixels::constant;
use super::pyramid::{Level, Pyramid};
use crate::ops::sparse_apply;
use crate::random::uniform;
use burn::config::Config;
use burn::module::{Module, Param};
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Widths of the shared MLPs at scales 1 to 4.
pub const WIDTHS: [usize; 4] = [64, 64, 128, 256];
/// Channels of the hidden features that are blended; the last FC maps them to classes.
pub const HIDDEN: usize = WIDTHS[0];
/// Purpose of the random stream of the initial weights.
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
    /// Whether LayerNorm follows each linear map, as where the example `pretrain_encoder` trains the point encoder.
    #[config(default = false)]
    pub layer_norm: bool,
    /// Seed of the initial weights.
    #[config(default = 0)]
    pub seed: u64,
}

impl DecoderConfig {
    /// The decoder that reads `pyramid`.
    pub fn for_pyramid(pyramid: &Pyramid, classes: usize) -> Self {
        let channels = |features: &Tensor<2>| features.dims()[1];
        let levels = pyramid.levels.iter().take(WIDTHS.len());
        let features = levels.map(|level| channels(&level.features)).collect();
        Self::new(features, channels(&pyramid.top), classes)
    }

    /// A decoder with seeded initial weights, uniform in +-1/sqrt(inputs of the layer).
    pub fn init(&self, device: &Device) -> Decoder {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(INIT_STREAM);
        let scales = self.features.len().min(WIDTHS.len());
        let layers = (0..scales).map(|n| {
            let width = WIDTHS[n];
            let below = if n + 1 < scales {
                WIDTHS[n + 1]
            } else {
                self.top
            };
            let bound = bound(self.features[n] + below);
            let mut map = |inputs: usize| {
                let values = uniform(inputs * width, bound, &mut rng);
                (inputs > 0).then(|| parameter(values, [inputs, width], device))
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
        Decoder {
            layers,
            last: linear(HIDDEN, self.classes, &mut rng, device),
        }
    }
}

/// The shared MLP of a scale, over the frozen features of a level and what comes up from below.
#[derive(Module, Debug)]
struct FusionLayer {
    features: Option<Param<Tensor<2>>>,
    below: Option<Param<Tensor<2>>>,
    bias: Param<Tensor<1>>,
    norm: Option<LayerNorm>,
}

impl FusionLayer {
    /// `[N_n, width]` from the frozen features of `level` and `below` `[N_(n+1), width below]`. The linear map of a
    /// concatenation is the sum of the maps of its parts, and US(y) W = US(y W).
    fn forward(&self, level: &Level, below: Tensor<2>) -> Tensor<2> {
        let bias = self.bias.val();
        let device = bias.device();
        let upsampled = self.below.as_ref().map(|weight| {
            let below = product(constant(below, &device), weight.val());
            sparse_apply(below, level.upsample.clone())
        });
        let own = self.features.as_ref().map(|weight| {
            let features = constant(level.features.clone(), &device);
            product(features, weight.val())
        });
        let sum = match (own, upsampled) {
            (Some(own), Some(upsampled)) => add_bias(own + upsampled, bias),
            (Some(sum), None) | (None, Some(sum)) => add_bias(sum, bias),
            (None, None) => bias
                .unsqueeze::<2>()
                .expand([level.points.len(), self.bias.dims()[0]]),
        };
        let sum = match &self.norm {
            Some(norm) => norm.forward(sum),
            None => sum,
        };
        leaky_relu(sum)
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

/// The decoder (Eq. 7): at each scale a shared MLP (a linear map and LeakyReLU 0.2), and a last FC.
///
/// ```text
/// y_n = MLP_n(f_d,n (+) f_s,n (+) US(y_(n+1)))   for n = 4, 3, 2, 1, where y_5 = f_e
/// s   = FC(y_1)                                   (Eq. 7)
/// ```
///
/// (+) is concatenation, US upsampling, and f_e the encoder's last output. The formula of the paper leaves out MLP_1, but its text
/// names four MLP layers. The code sums linear maps instead of concatenating, W (a (+) b) = W_a a + W_b b, and upsamples after the
/// product, W US(y) = US(W y). [`Decoder::forward`] gives the y_n, and [`Decoder::classify`] is the FC.
#[derive(Module, Debug)]
pub struct Decoder {
    layers: Vec<FusionLayer>,
    last: Linear,
}

impl Decoder {
    /// Decodes `pyramid` from global to local. Gradients flow to the parameters, and to features that track them.
    ///
    /// # Panics
    /// If `pyramid` has fewer levels or widths other than those the decoder was made for.
    pub fn forward(&self, pyramid: &Pyramid) -> Decoded {
        let fused = self.fuse(pyramid, 0);
        let hidden = fused.first().unwrap_or(&pyramid.top).clone();
        Decoded { hidden, fused }
    }

    /// [`Decoded::fused`] from scale `finest` (zero-based) on: Eq. 9 reads the coarse scales alone.
    ///
    /// # Panics
    /// As [`Decoder::forward`].
    pub fn fuse(&self, pyramid: &Pyramid, finest: usize) -> Vec<Tensor<2>> {
        assert!(
            self.layers.len() <= pyramid.levels.len(),
            "levels of the pyramid against layers of the decoder"
        );
        let mut below = pyramid.top.clone();
        let mut fused = Vec::with_capacity(self.layers.len());
        let scales = self.layers.iter().zip(&pyramid.levels).skip(finest);
        for (layer, level) in scales.rev() {
            below = layer.forward(level, below);
            fused.push(below.clone());
        }
        fused.reverse();
        fused
    }

    /// Logits `[rows, C]` of hidden features `[rows, 64]`, of Gaussians or of pixels.
    ///
    /// The FC commutes with blending: of hidden features blended with weights that sum to 1 - T, the blended logits are
    /// `blended W + (1 - T) b`. Divided by 1 - T, as the label loss wants them, they are `classify(blended / (1 - T))`.
    pub fn classify(&self, hidden: Tensor<2>) -> Tensor<2> {
        let logits = product(hidden, self.last.weight.val());
        match &self.last.bias {
            Some(bias) => add_bias(logits, bias.val()),
            None => logits,
        }
    }

    /// The decoder with its last layer at zero: all scores are 0 until it has learned.
    #[must_use]
    pub fn with_silent_start(mut self) -> Self {
        fn silent<const D: usize>(tensor: Tensor<D>) -> Tensor<D> {
            Tensor::from_inner(tensor.inner().zeros_like()).require_grad()
        }
        self.last.weight = self.last.weight.map(silent);
        self.last.bias = self.last.bias.map(|bias| bias.map(silent));
        self
    }
}
