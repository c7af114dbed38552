//! Gaussian Grouping (Ye et al. 2024): a short identity code for each Gaussian, classified after blending.

use super::super::encode::Inputs;
use super::super::train_decoder::{DecodedScores, IdentityModel, identities};
use super::{first_parameters, linear};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use crate::random::{Purpose, stream, uniform};
use crate::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use crate::segmentation::neighbours::without_self;
use crate::segmentation::randla::parameter;
use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

/// Channels of a code.
const CODE_CHANNELS: usize = 16;
/// First codes are uniform in +- this: the original's spherical harmonics of random colours.
const INITIAL_RANGE: f32 = 1.77;
/// Gaussians whose neighbours the 3D loss reads in an iteration, and neighbours of each.
const SAMPLES: usize = 1_000;
const NEIGHBOURS: usize = 5;

/// The learned parameters.
#[derive(Module, Debug)]
pub struct Codes {
    codes: Param<Tensor<2>>,
    classifier: Linear,
}

/// A code of 16 numbers for each Gaussian, blended and classified by a linear map, under cross-entropy and a KL divergence of
/// neighbours in 3D (k = 5, m = 1000).
///
/// The linear map commutes with blending, so Gaussians are classified and their logits blended. The bias then counts by the coverage
/// 1 - T of a pixel; training pixels are normalised to a coverage of 1. Differences from the original: labels are classes instead of
/// tracked masks; the 3D loss is taken in every iteration instead of every fifth; codes and classifier have one learning rate. Where
/// a segmenter's scores lie beside the labels, cross-entropy is to their distribution.
pub struct Grouping {
    module: Codes,
    /// The nearest others of each Gaussian, `[N, 5]`.
    neighbours: Vec<u32>,
    seed: u64,
}

impl Grouping {
    /// Weight of the 3D loss.
    pub const LAMBDA_3D: f64 = 2.0;

    /// Random codes for the Gaussians of `inputs`, on an autodiff `device`.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming a centre.
    pub fn new(inputs: &Inputs, device: &Device) -> Result<Self> {
        let count = inputs.gaussians.len();
        let classes = inputs.scene.classes.len();
        let mut rng = first_parameters(inputs);
        let codes = uniform(count * CODE_CHANNELS, INITIAL_RANGE, &mut rng);
        Ok(Self {
            module: Codes {
                codes: parameter(codes, [count, CODE_CHANNELS], device),
                classifier: linear(CODE_CHANNELS, classes, &mut rng, device),
            },
            neighbours: without_self(&inputs.gaussians.means, NEIGHBOURS)?,
            seed: inputs.config.seed,
        })
    }

    /// Logits `[rows, C]` of the Gaussians `rows`.
    fn logits(&self, rows: &[u32]) -> Tensor<2> {
        let codes = select(&self.module.codes.val(), rows);
        self.module.classifier.forward(codes)
    }

    /// The mean KL divergence of a sample of Gaussians to their neighbours; none for a single Gaussian.
    fn divergence(&self, iteration: usize) -> Option<Tensor<1>> {
        let count = self.module.codes.dims()[0];
        if count < 2 {
            return None;
        }
        let mut rng = stream(self.seed, Purpose::Regularisation, iteration as u64);
        let chosen = rand::seq::index::sample(&mut rng, count, SAMPLES.min(count));
        let mut rows: Vec<u32> = chosen.iter().map(|row| row as u32).collect();
        let pairs = NeighbourPairs::new(rows.clone(), &self.neighbours, NEIGHBOURS);
        let samples = rows.len() as u32;
        rows.extend(&pairs.neighbours);
        let places = NeighbourPairs {
            chosen: (0..samples).collect(),
            neighbours: (samples..rows.len() as u32).collect(),
        };
        Some(neighbour_divergence(self.logits(&rows), &places))
    }
}

impl IdentityModel for Grouping {
    type Module = Codes;

    fn module(&self) -> &Codes {
        &self.module
    }

    fn set_module(&mut self, module: Codes) {
        self.module = module;
    }

    fn decode(&mut self, _view: usize, visible: &[u32], iteration: usize) -> Result<DecodedScores> {
        Ok(DecodedScores {
            regularisation: self.divergence(iteration),
            ..self.logits(visible).into()
        })
    }

    fn identities(&self, module: Codes) -> Result<Identities> {
        let module = module.valid();
        identities(module.classifier.forward(module.codes.val()))
    }
}
