//! How a variant is trained: losses, learning rates and pixels over the iterations.

use super::view_input::REGULARISED;
use crate::config::{self, LAMBDA_PIX, Reduction, SegmentationConfig};
use crate::segmentation::loss::LabelLoss;

/// How a variant is trained.
#[derive(Clone, Debug)]
pub struct TrainingPlan {
    /// Settings of stage two, with those that the variant has of its own.
    pub config: SegmentationConfig,
    /// Label loss after the warm-up.
    pub loss: LabelLoss,
    /// Iterations of cross-entropy before it.
    pub warmup: usize,
    /// Recall below which a class learns by a less robust loss, see [`super::ClassRecall`]; 0 is never.
    pub least_recall: f64,
    /// Weights of the label loss and of the 3D regularisation.
    pub lambda: [f64; 2],
    /// Seed of view order and pixel choice.
    pub seed: u64,
}

impl TrainingPlan {
    /// The plan of `config` under `loss`.
    pub fn new(config: &SegmentationConfig, loss: LabelLoss, seed: u64) -> Self {
        let warmup = match loss {
            LabelLoss::Ce => 0,
            _ => (config.warmup * config.iterations as f64).round() as usize,
        };
        let least_recall = match (loss, config.loss()) {
            (LabelLoss::Gce { .. }, config::LabelLoss::Gce { least_recall, .. }) => least_recall,
            _ => 0.0,
        };
        Self {
            config: config.clone(),
            loss,
            warmup,
            least_recall,
            lambda: [LAMBDA_PIX, config.lambda_reg],
            seed,
        }
    }

    /// Share of the learning rate at `iteration` (from 0).
    pub fn rate_factor(&self, iteration: usize) -> f64 {
        if !self.config.lr_decay {
            return 1.0;
        }
        let done = iteration as f64 / self.config.iterations.max(1) as f64;
        0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * done).cos())
    }

    /// Weights of the mean label loss of `pixels` pixels and of the mean divergence of neighbours, summed over scales.
    pub(super) fn weights_of_means(&self, pixels: usize) -> [f64; 2] {
        let [label, regularisation] = self.lambda;
        match self.config.reduction {
            Reduction::Mean => self.lambda,
            Reduction::Sum => {
                let scales = REGULARISED.len() as f64;
                let regularisation = regularisation * self.config.reg_neighbours as f64 / scales;
                [label * pixels as f64, regularisation]
            }
        }
    }

    /// The label loss at `iteration`.
    pub(super) fn label_loss(&self, iteration: usize) -> LabelLoss {
        if iteration < self.warmup {
            LabelLoss::Ce
        } else {
            self.loss
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_weigh_pixels_and_neighbours_by_their_numbers() {
        let mut config = SegmentationConfig::default();
        let weights = |config: &SegmentationConfig| {
            TrainingPlan::new(config, LabelLoss::Ce, 0).weights_of_means(1_000)
        };
        assert_eq!(weights(&config), [0.8, 0.2]);
        config.reduction = Reduction::Sum;
        // Five neighbours and two scales.
        assert_eq!(weights(&config), [800.0, 0.5]);
    }
}
