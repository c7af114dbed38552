//! Identities learned for each Gaussian (ablation row 1 of the paper): `N x C` free logits under cross-entropy.

use super::decoder_model::stored_scores;
use super::{DecodedScores, IdentityModel, identities};
use crate::config::Blend;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use crate::segmentation::linear::parameter;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

/// The free logits.
#[derive(Module, Debug)]
pub struct Logits {
    scores: Param<Tensor<2>>,
}

impl Logits {
    /// Zeros for `size` = Gaussians x classes, on an autodiff `device`.
    pub fn zeros(size: [usize; 2], device: &Device) -> Self {
        let scores = Param::from_tensor(Tensor::zeros(size, device));
        Self { scores }
    }

    /// Logits that give the `probabilities` with `floor` added to each, on an autodiff `device`.
    pub fn starting_at(probabilities: &Identities, floor: f32, device: &Device) -> Self {
        let logits = probabilities.scores.iter().map(|p| (p + floor).ln());
        Self::new(logits.collect(), probabilities.classes, device)
    }

    /// Logits of `scores` for each Gaussian and each of `classes`, on an autodiff `device`.
    pub fn new(scores: Vec<f32>, classes: usize, device: &Device) -> Self {
        let size = [scores.len() / classes.max(1), classes];
        Self {
            scores: parameter(scores, size, device),
        }
    }

    /// The logits of the Gaussians `rows`.
    pub fn of(&self, rows: &[u32]) -> Tensor<2> {
        select(&self.scores.val(), rows)
    }
}

/// Scores that each Gaussian learns by itself; `.0` says how they are blended.
pub struct PerGaussian(pub Blend);

impl IdentityModel for PerGaussian {
    type Module = Logits;

    fn decode(
        &mut self,
        logits: &Logits,
        _view: usize,
        visible: &[u32],
        _iteration: usize,
    ) -> Result<DecodedScores> {
        Ok(logits.of(visible).into())
    }

    fn identities(&self, logits: Logits) -> Result<Identities> {
        identities(stored_scores(logits.scores.val().inner(), self.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::open_cpu;

    #[test]
    fn training_starts_at_the_probabilities() {
        let start = Identities {
            scores: vec![0.7, 0.3, 0.0, 0.0, 0.0, 1.0],
            classes: 3,
        };
        let device = open_cpu().unwrap().autodiff();
        let logits = Logits::starting_at(&start, 0.002, &device);
        let model = PerGaussian(Blend::Probabilities);
        let found = model.identities(logits).unwrap();
        for (found, p) in found.scores.iter().zip(&start.scores) {
            let floored = (p + 0.002) / 1.006;
            assert!((found - floored).abs() < 1e-6, "{found} against {floored}");
        }
    }
}
