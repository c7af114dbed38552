//! Stage two: identities are learned from raw labels while the geometry is frozen.
//!
//! [`train_decoder`] runs [`train_step`] for each iteration: draw labelled pixels of a view, predict their class scores
//! with an [`IdentityModel`], and follow the gradient of the CoSeg loss (Eq. 10).

mod class_recall;
mod decoder_model;
mod in_parts;
mod optimiser;
mod per_gaussian;
mod pixel_sample;
mod rendered;
mod training;
mod view_input;
mod views;

pub use self::class_recall::ClassRecall;
pub use self::decoder_model::{DecoderInput, DecoderModel, DecoderPlan, Encoded, dropped_channels};
pub use self::optimiser::{ModuleAdam, NamedValues};
pub use self::per_gaussian::PerGaussian;
pub use self::pixel_sample::view_at;
pub use self::training::{Evaluate, Schedule, TrainingRun, train_decoder};
pub use self::views::{TrainingViews, ViewSample};

use crate::config::{self, Blend, SegmentationConfig};
use crate::error::{Error, Result};
use crate::objects::Identities;
use crate::random::{Purpose, stream};
use crate::segmentation::loss::{CoSegLoss, LabelLoss, Scores};
use burn::tensor::activation::softmax;
use burn::tensor::{Gradients, Tensor};

/// Class scores of some pixels, with their 3D regularisation.
pub struct Prediction {
    /// Class scores.
    pub scores: Scores,
    /// Eq. 9, where the model has one.
    pub regularisation: Option<Tensor<1>>,
}

/// A model that stage two trains: it predicts class scores and stores identities.
pub trait IdentityModel {
    /// Scores of the sampled pixels of training view `view`.
    ///
    /// # Errors
    /// When a frozen input is not finite, or the device fails.
    fn predict(&mut self, view: usize, sample: &ViewSample) -> Result<Prediction>;
    /// One optimiser step at `factor` times the learning rate. `loss` (`[1]`, without autodiff) and `gradients` belong to the
    /// last prediction. Returns the value of the loss.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the loss or the parameter, [`Error::Device`] when the device fails. The model is unchanged
    /// then.
    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32>;
    /// The identities to store, `[N, C]`.
    ///
    /// # Errors
    /// When a frozen input is not finite.
    fn identities(&mut self) -> Result<Identities>;
    /// Bytes of everything that is learned.
    fn learnable_bytes(&self) -> usize;
    /// Parameters, moments and counters, by name.
    fn state(&self) -> NamedValues;
    /// Restores what [`IdentityModel::state`] returned; `None` when a name is missing.
    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()>;
}

/// How a variant is trained.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Label loss after the warm-up.
    pub loss: LabelLoss,
    /// Iterations of cross-entropy before it.
    pub warmup: usize,
    /// All iterations.
    pub iterations: usize,
    /// Recall below which a class learns by a less robust loss, see [`ClassRecall`]; 0 is never.
    pub least_recall: f64,
    /// Weights of the label loss and of the 3D regularisation.
    pub lambda: [f64; 2],
    /// Share of the pixels in a step.
    pub pixel_share: f64,
    /// Whether the learning rate falls along a half cosine, to 1 % at the end.
    pub decay: bool,
    /// Seed of view order and pixel choice.
    pub seed: u64,
}

impl Plan {
    /// The plan of `config` under `loss`.
    pub fn new(config: &SegmentationConfig, loss: LabelLoss, seed: u64) -> Self {
        let warmup = match loss {
            LabelLoss::Ce => 0,
            _ => (config.warmup * config.iterations as f64).round() as usize,
        };
        let least_recall = match (loss, config.loss) {
            (LabelLoss::Gce { .. }, config::LabelLoss::Gce { least_recall, .. }) => least_recall,
            _ => 0.0,
        };
        Self {
            loss,
            warmup,
            iterations: config.iterations,
            least_recall,
            lambda: [config.lambda_pix, config.lambda_reg],
            pixel_share: config.pixel_share,
            decay: config.lr_decay,
            seed,
        }
    }

    /// Share of the learning rate at `iteration` (from 0).
    pub fn rate_factor(&self, iteration: usize) -> f64 {
        if !self.decay {
            return 1.0;
        }
        let done = iteration as f64 / self.iterations.max(1) as f64;
        0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * done).cos())
    }

    /// The loss at `iteration`.
    fn loss_at(&self, iteration: usize) -> CoSegLoss {
        let label = if iteration < self.warmup {
            LabelLoss::Ce
        } else {
            self.loss
        };
        CoSegLoss {
            label,
            lambda: self.lambda,
            robustness: Vec::new(),
        }
    }
}

/// One iteration of `model`. Returns the loss.
///
/// # Errors
/// [`Error::NonFinite`] naming view and iteration, [`Error::Limit`] and [`Error::Device`] where a GPU fails. The model is
/// unchanged then.
pub fn train_step(
    model: &mut dyn IdentityModel,
    views: &mut TrainingViews,
    plan: &Plan,
    recall: &mut ClassRecall,
    iteration: usize,
) -> Result<f32> {
    let view = view_at(plan.seed, iteration, views.len());
    let mut rng = stream(plan.seed, Purpose::Pixels, iteration as u64);
    let sample = views.sample(view, plan.pixel_share, &mut rng)?;
    if sample.pixels.labels.is_empty() {
        return Ok(0.0);
    }
    let mut step = || {
        let prediction = model.predict(view, &sample)?;
        let mut loss = plan.loss_at(iteration);
        if plan.least_recall > 0.0 {
            recall.measure(&prediction.scores, &sample.pixels, iteration)?;
            loss.robustness = recall.robustness(plan.least_recall);
        }
        let loss = loss.forward(prediction.scores, &sample.pixels, prediction.regularisation)?;
        let mut gradients = loss.backward();
        model.step(loss.inner(), &mut gradients, plan.rate_factor(iteration))
    };
    step().map_err(|error| match error {
        Error::NonFinite { tensor, row, .. } => Error::NonFinite {
            tensor,
            row,
            context: format!(
                ", view {}, segmentation iteration {iteration}",
                views.name(view)
            ),
        },
        other => other,
    })
}

/// Scores in the form that identities store.
fn stored(scores: Tensor<2>, blend: Blend) -> Tensor<2> {
    match blend {
        Blend::Logits => scores,
        Blend::Probabilities => softmax(scores, 1),
    }
}
