//! Gaussian Grouping (Ye et al. 2024): a short identity code for each Gaussian, classified after blending.

use super::super::segmentation_inputs::SegmentationInputs;
use super::super::train_decoder::{DecodedScores, IdentityModel, identities};
use super::initial_parameters;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use crate::random::{Purpose, stream, uniform};
use crate::segmentation::linear::linear;
use crate::segmentation::linear::parameter;
use crate::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use crate::segmentation::neighbours::without_self;
use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

/// Channels of a code.
const CODE_CHANNELS: usize = 16;
/// Initial codes are uniform in +- this: the original's spherical harmonics of random colours.
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

impl Codes {
    /// Random ones for the Gaussians of `inputs`, on an autodiff `device`.
    pub fn random(inputs: &SegmentationInputs, device: &Device) -> Self {
        let count = inputs.gaussians.len();
        let classes = inputs.scene.classes.len();
        let mut rng = initial_parameters(inputs);
        let codes = uniform(count * CODE_CHANNELS, INITIAL_RANGE, &mut rng);
        Self {
            codes: parameter(codes, [count, CODE_CHANNELS], device),
            classifier: linear(CODE_CHANNELS, classes, &mut rng, device),
        }
    }

    /// Logits `[rows, C]` of the Gaussians `rows`.
    fn logits(&self, rows: &[u32]) -> Tensor<2> {
        self.classifier.forward(select(&self.codes.val(), rows))
    }
}

/// A code of 16 numbers for each Gaussian, blended and classified by a linear map, under cross-entropy and a KL divergence of
/// neighbours in 3D (k = 5, m = 1000).
///
/// The linear map commutes with blending, so Gaussians are classified and their logits blended. The bias then counts by the coverage
/// 1 - T of a pixel; training pixels are normalised to a coverage of 1. Differences from the original: labels are classes instead of
/// tracked masks; the 3D loss is taken in every iteration instead of every fifth; codes and classifier have one learning rate. Where
/// a segmenter's scores lie beside the labels, cross-entropy is to their distribution.
pub struct Grouping {
    /// The nearest others of each Gaussian, `[N, 5]`.
    neighbours: Vec<u32>,
    seed: u64,
}

impl Grouping {
    /// Weight of the 3D loss.
    pub const LAMBDA_3D: f64 = 2.0;

    /// The neighbours of the Gaussians of `inputs`.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming a centre.
    pub fn new(inputs: &SegmentationInputs) -> Result<Self> {
        Ok(Self {
            neighbours: without_self(&inputs.gaussians.means, NEIGHBOURS)?,
            seed: inputs.config.seed,
        })
    }

    /// The mean KL divergence of a sample of Gaussians to their neighbours; none for a single Gaussian.
    fn divergence(&self, codes: &Codes, iteration: usize) -> Option<Tensor<1>> {
        let count = codes.codes.dims()[0];
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
        Some(neighbour_divergence(codes.logits(&rows), &places))
    }
}

impl IdentityModel for Grouping {
    type Module = Codes;

    fn decode(
        &mut self,
        codes: &Codes,
        _view: usize,
        visible: &[u32],
        iteration: usize,
    ) -> Result<DecodedScores> {
        Ok(DecodedScores {
            regularisation: self.divergence(codes, iteration),
            ..codes.logits(visible).into()
        })
    }

    fn identities(&self, codes: Codes) -> Result<Identities> {
        let codes = codes.valid();
        identities(codes.classifier.forward(codes.codes.val()))
    }
}
