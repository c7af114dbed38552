//! Identities learned for each Gaussian (ablation row 1 of the paper): `N x C` free logits under cross-entropy.

use super::decoder_model::stored_scores;
use super::{DecodedScores, IdentityModel};
use crate::backend::device::read;
use crate::config::Blend;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::select;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

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
        let scores = Param::from_tensor(Tensor::zeros(size, device));
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
        Ok(DecodedScores {
            scores: vec![select(&self.logits.scores.val(), visible)],
            regularisation: None,
            parts: None,
        })
    }

    fn identities(&self, logits: Logits) -> Result<Identities> {
        let scores = logits.scores.val().inner();
        Ok(Identities {
            classes: scores.dims()[1],
            scores: read("identities", stored_scores(scores, self.blend))?,
        })
    }
}
