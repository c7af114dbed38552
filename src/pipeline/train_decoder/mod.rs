//! Stage two: segmentation identities from raw labels, geometry frozen.

mod chunked;
mod consistency;
mod drawing;
mod fused;
mod optimiser;
mod per_gaussian;
mod prepared;
mod recalls;
mod rendered;
mod session;
mod views;

pub use self::consistency::{dropped_channels, generalised_js};
pub use self::drawing::view_at;
pub use self::fused::{Encoded, Fused, FusedPlan, Source};
pub use self::optimiser::{ModuleAdam, NamedValues};
pub use self::per_gaussian::PerGaussian;
pub use self::recalls::Recalls;
pub use self::session::{Pace, Score, Session, train};
pub use self::views::{Drawn, TrainingViews};

use crate::backend::device::read;
use crate::config::{Blend, LabelLoss, SegmentationConfig};
use crate::error::{Error, Result};
use crate::objects::Identities;
use crate::ops::{ClassLosses, LabelledPixels, blended_label_loss, label_losses};
use crate::random::{Purpose, stream};
use crate::segmentation::loss::Kind;
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Gradients, Int, Tensor, TensorData};
use std::sync::Arc;

/// Class scores, before or after blending.
pub enum Scores {
    /// Of pixels: blended logits over `1 - T`, `[P, C]`.
    Pixels(Tensor<2>),
    /// Of the view's visible Gaussians, `[V, C]`: the probabilities they stand for are blended.
    Gaussians(Tensor<2>),
    /// Two predictions from different parts of the input, each as one of the above.
    Pair(Box<[Scores; 2]>),
}

impl Scores {
    /// Those of `scores` `[V, C]` of visible Gaussians as `blend` says.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn blended(scores: Tensor<2>, pixels: &LabelledPixels, blend: Blend) -> Result<Self> {
        Ok(match blend {
            Blend::Logits => Self::Pixels(pixels.blend(scores)?),
            Blend::Probabilities => Self::Gaussians(scores),
        })
    }

    /// This prediction and another one.
    fn and(self, other: Self) -> Self {
        Self::Pair(Box::new([self, other]))
    }

    /// Mean loss `[1]` of `pixels`; of a pair [`generalised_js`] for all classes, with the weight `consistency`.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn loss(
        self,
        pixels: LabelledPixels,
        losses: &ClassLosses,
        consistency: f64,
    ) -> Result<Tensor<1>> {
        Ok(match self {
            Self::Pixels(logits) => label_losses(logits, &pixels.labels, losses),
            Self::Gaussians(scores) => blended_label_loss(scores, Arc::new(pixels), losses)?,
            Self::Pair(pair) => {
                let [a, b] = pair.map(|scores| scores.probabilities(&pixels));
                generalised_js([a?, b?], &pixels.labels, &losses.kind, consistency)
            }
        })
    }

    /// Class probabilities of the pixels at these places among `pixels`, row-major, without gradient; of a pair those of its first.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`] and [`Error::Device`] when they cannot be read.
    fn probabilities_at(&self, pixels: &LabelledPixels, places: &[u32]) -> Result<Vec<f32>> {
        let probabilities = match self {
            Self::Pixels(logits) => {
                let rows = TensorData::new(
                    places.iter().map(|&p| i64::from(p)).collect::<Vec<_>>(),
                    [places.len()],
                );
                let rows = Tensor::<1, Int>::from_data(rows, &logits.device());
                softmax(logits.clone().detach().select(0, rows), 1)
            }
            Self::Gaussians(scores) => {
                let rows = places.iter().map(|&p| pixels.rows[p as usize]).collect();
                let labels = places.iter().map(|&p| pixels.labels[p as usize]).collect();
                let some = LabelledPixels::new(pixels.weights.clone(), rows, labels);
                some.blend(softmax(scores.clone().detach(), 1))?
            }
            Self::Pair(pair) => return pair[0].probabilities_at(pixels, places),
        };
        read("class probabilities of pixels", probabilities)
    }

    /// Class probabilities of the pixels, `[P, C]`; of a pair their mean.
    fn probabilities(self, pixels: &LabelledPixels) -> Result<Tensor<2>> {
        Ok(match self {
            Self::Pixels(logits) => softmax(logits, 1),
            Self::Gaussians(scores) => pixels.blend(softmax(scores, 1))?,
            Self::Pair(pair) => {
                let [a, b] = pair.map(|scores| scores.probabilities(pixels));
                (a? + b?) * 0.5
            }
        })
    }
}

/// What a model says of some pixels.
pub struct Prediction {
    /// Class scores.
    pub scores: Scores,
    /// Eq. 9, where the model has one.
    pub regularisation: Option<Tensor<1>>,
}

/// Something that stage two trains: it predicts class scores and stores identities.
pub trait Model {
    /// Scores of what was drawn of training view `view`.
    ///
    /// # Errors
    /// When a frozen input is not finite; those of [`LabelledPixels::blend`].
    fn predict(&mut self, view: usize, drawn: &Drawn) -> Result<Prediction>;
    /// One optimiser step at `factor` times the learning rate: `loss` (`[1]`, without autodiff) is one of the last prediction,
    /// `gradients` are its. Gives the value of the loss.
    ///
    /// # Errors
    /// [`Error::NonFinite`] naming the loss or the parameter, [`Error::Device`] when the device fails; nothing has changed then.
    fn step(&mut self, loss: Tensor<1>, gradients: &mut Gradients, factor: f64) -> Result<f32>;
    /// The identities as they are to be stored, `[N, C]`.
    ///
    /// # Errors
    /// When a frozen input is not finite.
    fn identities(&mut self) -> Result<Identities>;
    /// Bytes of everything that is learned.
    fn learnable_bytes(&self) -> usize;
    /// Parameters, moments and counters, by name.
    fn state(&self) -> NamedValues;
    /// Takes back what [`Model::state`] gave; `None` when something is missing.
    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()>;
}

/// How a row is trained.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Loss after the warm-up.
    pub loss: Kind,
    /// Iterations of cross-entropy before it.
    pub warmup: usize,
    /// All iterations.
    pub iterations: usize,
    /// Mean probability of its own labels below which a class is learnt by GCE with a smaller exponent; 0 is never.
    pub least_recall: f64,
    /// Weights of the label loss and of the 3D regularisation.
    pub lambda: [f64; 2],
    /// Weight, within the label loss, of how far two predictions are apart, where a model makes two.
    pub consistency: f64,
    /// Share of the pixels in a step.
    pub pixel_share: f64,
    /// Whether the learning rate falls along a half cosine, to 1 % at the end.
    pub decay: bool,
    /// Seed of view order and pixel choice.
    pub seed: u64,
}

impl Plan {
    /// The plan of `config` under `loss`.
    pub fn new(config: &SegmentationConfig, loss: Kind, seed: u64) -> Self {
        let warmup = match loss {
            Kind::Ce => 0,
            _ => (config.warmup * config.iterations as f64).round() as usize,
        };
        Self {
            loss,
            warmup,
            iterations: config.iterations,
            least_recall: match (loss, config.loss) {
                (Kind::Gce { .. }, LabelLoss::Gce { least_recall, .. }) => least_recall,
                _ => 0.0,
            },
            lambda: [config.lambda_pix, config.lambda_reg],
            // (1 - pi) / Z with the Z of Kind::Js
            consistency: match config.loss {
                LabelLoss::Gjs { pi_rl } => -(-pi_rl).ln_1p().recip(),
                _ => 0.0,
            },
            pixel_share: config.pixel_share,
            decay: config.lr_decay,
            seed,
        }
    }
}

impl Plan {
    /// Share of the learning rate in force at `iteration` (from 0).
    pub fn rate_factor(&self, iteration: usize) -> f64 {
        let done = iteration as f64 / self.iterations.max(1) as f64;
        if self.decay {
            0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * done).cos())
        } else {
            1.0
        }
    }
}

/// One iteration of `model`: returns the loss. `recalls` go from iteration to iteration.
///
/// # Errors
/// [`Error::NonFinite`] naming view and iteration, [`Error::Limit`] and [`Error::Device`] where a GPU cannot go on: before
/// anything is changed.
pub fn train_step(
    model: &mut dyn Model,
    views: &mut TrainingViews,
    plan: &Plan,
    recalls: &mut Recalls,
    iteration: usize,
) -> Result<f32> {
    let view = views.at(plan.seed, iteration);
    let mut rng = stream(plan.seed, Purpose::Pixels, iteration as u64);
    let drawn = views.draw(view, plan.pixel_share, &mut rng)?;
    if drawn.pixels.labels.is_empty() {
        return Ok(0.0);
    }
    let at = |error: Error| match error {
        Error::NonFinite { tensor, row, .. } => {
            let context = format!(
                ", view {}, segmentation iteration {iteration}",
                views.name(view)
            );
            Error::NonFinite {
                tensor,
                row,
                context,
            }
        }
        other => other,
    };
    let prediction = model.predict(view, &drawn).map_err(at)?;
    let kind = if iteration < plan.warmup {
        Kind::Ce
    } else {
        plan.loss
    };
    let mut losses = ClassLosses::from(kind);
    if plan.least_recall > 0.0 {
        recalls
            .measure(&prediction.scores, &drawn.pixels, iteration)
            .map_err(at)?;
        losses.shares = recalls.shares(plan.least_recall);
    }
    let consistency = if iteration < plan.warmup {
        0.0
    } else {
        plan.consistency
    };
    let loss = prediction
        .scores
        .loss(drawn.pixels, &losses, consistency)
        .map_err(at)?;
    let mut loss = loss * plan.lambda[0];
    if let Some(regularisation) = prediction.regularisation {
        loss = loss + regularisation * plan.lambda[1];
    }
    model
        .step(
            loss.clone().inner(),
            &mut loss.backward(),
            plan.rate_factor(iteration),
        )
        .map_err(at)
}

/// Scores as they are stored.
fn stored(scores: Tensor<2>, blend: Blend) -> Tensor<2> {
    match blend {
        Blend::Logits => scores,
        Blend::Probabilities => softmax(scores, 1),
    }
}

impl Prediction {
    /// No pixels.
    fn empty(classes: usize, device: &Device) -> Self {
        Self {
            scores: Scores::Pixels(Tensor::zeros([0, classes], device)),
            regularisation: None,
        }
    }
}
