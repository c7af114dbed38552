//! Identities learned for each Gaussian (ablation row 1 of the paper): `N x C` free logits under cross-entropy.

use super::optimiser::{self, ModuleAdam, NamedValues};
use super::views::ViewSample;
use super::{IdentityModel, Prediction, stored};
use crate::config::Blend;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::{SparseMatrix, sparse_apply};
use burn::module::{Module, Param};
use burn::tensor::{Device, Gradients, Tensor};
use std::sync::Arc;

#[derive(Module, Debug)]
struct Logits {
    scores: Param<Tensor<2>>,
}

/// The free logits with their optimiser.
pub struct PerGaussian {
    /// Absent only within a step.
    logits: Option<Logits>,
    adam: ModuleAdam,
    size: [usize; 2],
    blend: Blend,
    device: Device,
}

impl PerGaussian {
    /// Zero logits for `size` = Gaussians x classes, on an autodiff `device`.
    pub fn new(size: [usize; 2], rate: f64, blend: Blend, device: &Device) -> Self {
        let scores = Param::from_tensor(Tensor::zeros(size, device));
        Self {
            logits: Some(Logits { scores }),
            adam: ModuleAdam::new(rate),
            size,
            blend,
            device: device.clone(),
        }
    }

    fn logits(&self) -> &Logits {
        self.logits.as_ref().expect("present between steps")
    }
}

impl IdentityModel for PerGaussian {
    fn predict(&mut self, _view: usize, sample: &ViewSample) -> Result<Prediction> {
        let visible = SparseMatrix::selection(sample.visible.to_vec(), self.size[0]);
        let scores = sparse_apply(self.logits().scores.val(), Arc::new(visible));
        Ok(Prediction {
            scores: sample.blended(scores, self.blend)?,
            regularisation: None,
        })
    }

    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32> {
        let value = ModuleAdam::check(self.logits(), loss, gradients)?;
        // Taken, not cloned: buffers with one owner are updated in place.
        let logits = self.logits.take();
        self.logits = logits.map(|logits| self.adam.step(logits, gradients, factor));
        Ok(value)
    }

    fn identities(&mut self) -> Result<Identities> {
        let scores = self.logits().scores.val().inner();
        Ok(Identities {
            scores: optimiser::values(stored(scores, self.blend)),
            classes: self.size[1],
        })
    }

    fn learnable_bytes(&self) -> usize {
        4 * self.size[0] * self.size[1]
    }

    fn state(&self) -> NamedValues {
        let mut state = self.adam.state();
        state.extend(optimiser::parameters(self.logits()));
        state
    }

    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()> {
        self.adam = self.adam.clone().with_state(state, &self.device)?;
        self.logits = Some(optimiser::with_parameters(self.logits.take()?, state)?);
        Some(())
    }
}
