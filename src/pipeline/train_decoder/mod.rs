//! Stage two: identities are learned from raw labels while the geometry is frozen.
//!
//! [`Training::step`] goes through the views of a batch, by default one. For each it draws labelled pixels, decodes the scores of the
//! visible Gaussians (Eq. 7), blends them into the pixels (Eq. 3), and takes the CoSeg loss (Eq. 8 to 10). Then it makes a step of
//! Adam. [`Training::run`] repeats it.

mod adam;
mod checkpoint;
mod class_recall;
mod decoder_model;
mod per_gaussian;
mod plan;
mod sampling;
mod step;
mod view_input;
mod views;

pub use self::adam::Adam;
pub(super) use self::adam::parameter_gradients;
pub use self::class_recall::{ClassRecall, Measurement};
pub use self::decoder_model::{DecodedParts, DecoderModel, DecoderPlan};
pub use self::per_gaussian::{Logits, PerGaussian};
pub use self::plan::TrainingPlan;
pub(super) use self::sampling::stratified_sample;
pub use self::sampling::view_at;
pub use self::view_input::{DecoderInput, Encoded};
pub use self::views::{TrainingViews, ViewSample};

use crate::backend::device::read;
use crate::error::{Error, Result};
use crate::objects::Identities;
use crate::progress::{CurvePoint, Event, Progress};
use crate::provenance::Provenance;
use crate::ranks;
use crate::segmentation::loss::{CoSegLoss, Scores};
use burn::module::Module;
use burn::tensor::{Gradients, Tensor};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Instant;

/// Scores of the Gaussians of a view, with gradient to the parameters of the model.
pub struct DecodedScores {
    /// `[V, C]`.
    pub scores: Tensor<2>,
    /// Eq. 9, where the model has one.
    pub regularisation: Option<Tensor<1>>,
    /// Present where the scores were decoded in parts, without autodiff: they are leaves.
    pub parts: Option<DecodedParts>,
}

impl From<Tensor<2>> for DecodedScores {
    /// Scores that were decoded at once.
    fn from(scores: Tensor<2>) -> Self {
        Self {
            scores,
            regularisation: None,
            parts: None,
        }
    }
}

/// Scores `[N, C]` read back from their device.
pub(super) fn identities(scores: Tensor<2>) -> Result<Identities> {
    Ok(Identities {
        classes: scores.dims()[1],
        scores: read("identities", scores)?,
    })
}

/// The scores of an iteration in the pixels of a view.
pub struct Rendered<'a> {
    /// Number of the training view.
    pub view: usize,
    /// From 0.
    pub iteration: usize,
    /// Its drawn pixels.
    pub sample: &'a ViewSample,
    /// The scores in them.
    pub scores: Scores,
    /// Eq. 9, where the model has one.
    pub regularisation: Option<Tensor<1>>,
}

/// A model that stage two trains: how every Gaussian gets its class scores from parameters.
pub trait IdentityModel {
    /// The parameters.
    type Module: Module;

    /// Scores that the parameters `module` give the Gaussians `visible` in training view `view`.
    ///
    /// # Errors
    /// When a frozen input is not finite.
    fn decode(
        &mut self,
        module: &Self::Module,
        view: usize,
        visible: &[u32],
        iteration: usize,
    ) -> Result<DecodedScores>;

    /// The loss of an iteration, `[1]`: the CoSeg loss, unless the model has its own.
    ///
    /// # Errors
    /// Blending fails, or the labels of a view cannot be read.
    fn loss(&mut self, coseg: &CoSegLoss, rendered: Rendered) -> Result<Tensor<1>> {
        let pixels = &rendered.sample.pixels;
        coseg.forward(rendered.scores, pixels, rendered.regularisation)
    }

    /// The gradient of all parameters, `[P]`, from the `gradients` of a loss of what was `decoded` in `view`.
    fn gradient(
        &self,
        module: &Self::Module,
        _view: usize,
        _decoded: &DecodedScores,
        gradients: &mut Gradients,
    ) -> Tensor<1> {
        parameter_gradients(module, gradients)
    }

    /// The identities that the parameters `module` give, `[N, C]`.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return them.
    fn identities(&self, module: Self::Module) -> Result<Identities>;
}

/// A model in training.
pub struct Training<M: IdentityModel> {
    model: M,
    /// The parameters.
    pub module: M::Module,
    /// The optimizer.
    pub adam: Adam,
    recall: ClassRecall,
    iteration: usize,
    /// One point for each evaluation.
    pub curve: Vec<CurvePoint>,
    /// Seconds of training before the checkpoint that was resumed.
    pub earlier_seconds: f64,
    /// Seconds so far.
    seconds: f64,
    /// Losses since the last point of the curve.
    losses: Losses,
}

/// Sum and number of losses.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Losses {
    sum: f64,
    count: f64,
}

/// When a variant is evaluated and saved, and where.
#[derive(Clone, Debug)]
pub struct TrainingSchedule {
    /// Name of the variant, for progress.
    pub variant: &'static str,
    /// Number of Gaussians, for progress.
    pub gaussians: usize,
    /// Iterations between held-out evaluations.
    pub eval_every: usize,
    /// Iterations between checkpoints.
    pub checkpoint_every: usize,
    /// The checkpoint; none is written or read where it is absent.
    pub checkpoint: Option<PathBuf>,
    /// Settings and data of the training; a checkpoint of any other is refused.
    pub provenance: Provenance,
}

/// Scores a model on the held-out views: the pooled mIoU, or none without such views.
pub type Evaluate<'a, M> = &'a mut dyn FnMut(&Training<M>) -> Result<Option<f64>>;

impl<M: IdentityModel> Training<M> {
    /// `model` with the parameters `module` before the first step, with scores for `classes` classes.
    pub fn new(model: M, module: M::Module, adam: Adam, classes: usize) -> Self {
        Self {
            model,
            module,
            adam,
            recall: ClassRecall::new(classes),
            iteration: 0,
            curve: Vec::new(),
            earlier_seconds: 0.0,
            seconds: 0.0,
            losses: Losses::default(),
        }
    }

    /// Iterations so far.
    pub fn iteration(&self) -> usize {
        self.iteration
    }

    /// Bytes of everything that is learned.
    pub fn learnable_bytes(&self) -> usize {
        4 * self.module.num_params()
    }

    /// The identities to store. They come from the mean of the parameters where it is kept.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return them.
    pub fn identities(&self) -> Result<Identities> {
        let module = self.adam.averaged(self.module.clone());
        self.model.identities(module)
    }

    /// Trains by `plan` from the checkpoint, or from the start without one, to the end.
    ///
    /// # Errors
    /// Those of [`Training::step`]; the last checkpoint stays as it was. Those of reading or writing the checkpoint;
    /// [`Error::Config`] and [`Error::Input`] when it was made from other settings or data; [`Error::Stopped`].
    pub fn run(
        &mut self,
        views: &mut TrainingViews,
        plan: &TrainingPlan,
        schedule: &TrainingSchedule,
        evaluate: Evaluate<M>,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        self.resume(plan, schedule)?;
        self.earlier_seconds = self.seconds;
        ranks::expect_same("the iterations done", self.iteration.to_string())?;
        progress.event(&Event::Started {
            stage: schedule.variant,
            done: self.iteration,
            iterations: plan.config.iterations,
        });
        let mut stop = false;
        while self.iteration < plan.config.iterations && !stop {
            let clock = Instant::now();
            let before = self.iteration;
            let loss = f64::from(self.step(views, plan)?);
            self.seconds += clock.elapsed().as_secs_f64();
            let iteration = self.iteration;
            let batch = (iteration - before) as f64;
            self.losses.sum += loss * batch;
            self.losses.count += batch;
            progress.event(&Event::Step {
                iteration,
                loss,
                gaussians: schedule.gaussians,
            });
            stop = ranks::any(progress.stop())?;
            let end = iteration == plan.config.iterations;
            let due = |every: usize| {
                let crossed = iteration / every.max(1) > before / every.max(1);
                end || crossed
            };
            // A stop adds no point, so that the curve of a resumed run equals that of an uninterrupted one.
            if due(schedule.eval_every) {
                let point = self.evaluated(schedule.gaussians, evaluate)?;
                progress.event(&Event::Evaluated(point));
            }
            if let Some(path) = &schedule.checkpoint
                && (stop || due(schedule.checkpoint_every))
                && ranks::index() == 0
            {
                self.save(&schedule.provenance, path)?;
            }
        }
        if self.iteration < plan.config.iterations {
            return Err(Error::Stopped);
        }
        self.compare_ranks(schedule.variant)?;
        progress.event(&Event::Finished);
        Ok(())
    }

    /// A new point of the curve.
    fn evaluated(&mut self, gaussians: usize, evaluate: Evaluate<M>) -> Result<CurvePoint> {
        let losses = std::mem::take(&mut self.losses);
        let point = CurvePoint {
            iteration: self.iteration,
            seconds: self.seconds,
            loss: losses.sum / losses.count.max(1.0),
            miou: evaluate(self)?,
            gaussians,
            ..CurvePoint::default()
        };
        self.curve.push(point);
        Ok(point)
    }
}
