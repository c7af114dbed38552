//! Identities learned for each Gaussian (ablation row 1 of the paper): `N x C` free logits under cross-entropy.

use super::decoder_model::stored_scores;
use super::{DecodedScores, IdentityModel, identities};
use crate::config::Blend;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

/// The free logits.
#[derive(Module, Debug)]
pub struct Logits {
    scores: Param<Tensor<2>>,
}

/// Scores that each Gaussian learns by itself.
pub struct PerGaussian {
    logits: Logits,
    blend: Blend,
}

impl PerGaussian {
    /// Zero logits for `size` = Gaussians x classes, on an autodiff `device`.
    pub fn new(size: [usize; 2], blend: Blend, device: &Device) -> Self {
        Self::with_logits(Tensor::zeros(size, device), blend)
    }

    /// Logits that give the `probabilities` with `floor` added to each, on an autodiff `device`.
    pub fn starting_at(probabilities: &Identities, floor: f32, device: &Device) -> Self {
        let logits = probabilities.scores.iter().map(|p| (p + floor).ln());
        let classes = probabilities.classes;
        let size = [probabilities.scores.len() / classes.max(1), classes];
        let logits = TensorData::new(logits.collect(), size);
        Self::with_logits(Tensor::from_data(logits, device), Blend::Probabilities)
    }

    fn with_logits(logits: Tensor<2>, blend: Blend) -> Self {
        let scores = Param::from_tensor(logits);
        Self {
            logits: Logits { scores },
            blend,
        }
    }
}

impl IdentityModel for PerGaussian {
    type Module = Logits;

    fn module(&self) -> &Logits {
        &self.logits
    }

    fn set_module(&mut self, logits: Logits) {
        self.logits = logits;
    }

    fn decode(
        &mut self,
        _view: usize,
        visible: &[u32],
        _iteration: usize,
    ) -> Result<DecodedScores> {
        Ok(select(&self.logits.scores.val(), visible).into())
    }

    fn identities(&self, logits: Logits) -> Result<Identities> {
        identities(stored_scores(logits.scores.val().inner(), self.blend))
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
        let model = PerGaussian::starting_at(&start, 0.002, &device);
        let found = model.identities(model.logits.clone()).unwrap();
        for (found, p) in found.scores.iter().zip(&start.scores) {
            let floored = (p + 0.002) / 1.006;
            assert!((found - floored).abs() < 1e-6, "{found} against {floored}");
        }
    }
}
