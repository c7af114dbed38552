//! Identities learned per Gaussian (ablation row 1 of the paper): `N x C` free logits under cross-entropy.

use super::optimiser::{self, ModuleAdam, NamedValues};
use super::views::Drawn;
use super::{Model, Prediction, Scores, stored};
use crate::config::Blend;
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::gather_rows;
use burn::module::{Module, Param};
use burn::tensor::{Device, Gradients, Tensor};

#[derive(Module, Debug)]
struct Logits {
    scores: Param<Tensor<2>>,
}

/// The free logits with their optimiser.
pub struct PerGaussian {
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

    fn scores(&self) -> Tensor<2> {
        match &self.logits {
            Some(logits) => logits.scores.val(),
            None => Tensor::zeros(self.size, &self.device),
        }
    }
}

impl Model for PerGaussian {
    fn predict(&mut self, _view: usize, drawn: &Drawn) -> Result<Prediction> {
        let scores = Scores::blended(
            gather_rows(self.scores(), &drawn.visible),
            &drawn.pixels,
            self.blend,
        )?;
        Ok(Prediction {
            scores,
            regularisation: None,
        })
    }

    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32> {
        let Some(logits) = &self.logits else {
            return Ok(f32::NAN);
        };
        let value = ModuleAdam::check(logits, loss, gradients)?;
        // taken, not cloned: buffers that nobody else holds are updated in place
        self.logits = self
            .logits
            .take()
            .map(|logits| self.adam.step(logits, gradients, factor));
        Ok(value)
    }

    fn identities(&mut self) -> Result<Identities> {
        Ok(Identities {
            scores: optimiser::values(stored(self.scores().inner(), self.blend)),
            classes: self.size[1],
        })
    }

    fn learnable_bytes(&self) -> usize {
        4 * self.size[0] * self.size[1]
    }

    fn state(&self) -> NamedValues {
        let mut state = self.adam.state();
        state.extend(
            self.logits
                .as_ref()
                .map(optimiser::parameters)
                .unwrap_or_default(),
        );
        state
    }

    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()> {
        self.adam = self.adam.clone().with_state(state, &self.device)?;
        self.logits = Some(optimiser::with_parameters(self.logits.take()?, state)?);
        Some(())
    }
}
