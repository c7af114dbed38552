//! The variants of the label table: what each is, and its training and scoring.

use super::encode::{Encodings, Inputs, encode, spatial_of};
use super::evaluate::{FieldScores, HeldOut, HeldOutScores};
use super::fine_tuning::FineTuning;
use super::label_evidence::{LabelEvidence, VOTE_FLOOR};
use super::rivals::{Grouping, LinearHead, PanopticLifting, distil};
use super::train_decoder::{
    Adam, IdentityModel, PerGaussian, Training, TrainingPlan, TrainingSchedule, TrainingViews,
};
use super::variant_outcome::VariantOutcome;
use super::variant_training::{decoder_training, plan, schedule};
use crate::config::{Prior, SpatialConfig, Variant};
use crate::error::Result;
use crate::objects::Identities;
use crate::progress::{Event, Progress};
use std::cell::OnceCell;
use std::path::Path;

/// Learning rate of per-Gaussian identities.
const LR_PER_GAUSSIAN: f64 = 5e-2;
/// Learning rates of Gaussian Grouping and of the linear head of Feature 3DGS, the best on the built-in room of 0.01 to 0.2 and of
/// 0.01 to 0.1.
const LR_GROUPING: f64 = 0.1;
const LR_LINEAR_HEAD: f64 = 0.1;
/// Variants, trained and scored.
pub struct TrainedVariants {
    /// In the order of the configuration.
    pub rows: Vec<VariantOutcome>,
    /// Name of the point encoder's weights; empty where none were needed.
    pub spatial: String,
    /// Whether `progress` said stop before all variants were done.
    pub stopped: bool,
}

/// Trains and scores the configured variants in order, until `progress` says stop.
///
/// # Errors
/// Those of training, of the encoder's weights, and of checkpoints.
pub fn train_variants(
    inputs: &Inputs,
    checkpoints: &Path,
    progress: &mut dyn Progress,
) -> Result<TrainedVariants> {
    let variants = inputs.config.segmentation.rows();
    let mut stage = StageTwo::new(inputs, checkpoints);
    let mut rows: Vec<VariantOutcome> = Vec::new();
    let mut stopped = false;
    for &variant in variants {
        // The first variant always runs.
        stopped = !rows.is_empty() && progress.stop();
        if stopped {
            break;
        }
        let outcome = match variant {
            Variant::Raw => stage.raw(),
            Variant::Vote => stage.vote()?,
            Variant::PooledVote => stage.pooled_vote()?,
            Variant::PerGaussian => stage.per_gaussian(progress)?,
            Variant::Grouping => stage.grouping(progress)?,
            Variant::Distilled => stage.distilled(progress)?,
            Variant::PanopticLifting => stage.panoptic_lifting(progress)?,
            _ => stage.decoder(variant, progress)?,
        };
        if let Some(identities) = &outcome.identities {
            let ids = identities.ids(&inputs.scene.classes);
            progress.gaussians(inputs.gaussians, Some(&ids));
        }
        stopped = variant != Variant::Raw && outcome.identities.is_none();
        if !stopped {
            progress.event(&Event::Scored {
                variant: variant.title(),
                miou: outcome.scores.miou(),
            });
        }
        rows.push(outcome);
        if stopped {
            break;
        }
    }
    Ok(TrainedVariants {
        rows,
        spatial: stage.spatial,
        stopped,
    })
}

/// What the variants share.
struct StageTwo<'a> {
    inputs: &'a Inputs<'a>,
    checkpoints: &'a Path,
    views: TrainingViews<'a>,
    held_out: HeldOut<'a>,
    evidence: LabelEvidence<'a>,
    /// The last encodings, and the weights that they were made with.
    encodings: Option<(SpatialConfig, Encodings)>,
    /// Name of the encoder's weights; those of the random encoder only where there are no others.
    spatial: String,
    /// Scores of the lifted features.
    lifted: OnceCell<Option<FieldScores>>,
}

impl<'a> StageTwo<'a> {
    fn new(inputs: &'a Inputs<'a>, checkpoints: &'a Path) -> Self {
        Self {
            inputs,
            checkpoints,
            views: inputs.training_views(),
            held_out: HeldOut::new(inputs),
            evidence: LabelEvidence::new(inputs),
            encodings: None,
            spatial: String::new(),
            lifted: OnceCell::new(),
        }
    }

    /// The raw labels of the held-out views.
    fn raw(&self) -> VariantOutcome {
        let (scores, void_left_out) = self.held_out.score_raw(self.inputs);
        VariantOutcome {
            void_left_out,
            ..VariantOutcome::new(Variant::Raw, scores)
        }
    }

    /// The vote of the training views.
    fn vote(&self) -> Result<VariantOutcome> {
        let identities = self.evidence.votes()?.identities();
        let scores = self.held_out.score(&identities, self.inputs)?;
        Ok(VariantOutcome {
            identities: Some(identities),
            ..VariantOutcome::new(Variant::Vote, scores)
        })
    }

    /// The vote, pooled over superpoints and calibrated.
    fn pooled_vote(&self) -> Result<VariantOutcome> {
        let identities = self.evidence.pooled()?.identities.clone();
        let scores = self.held_out.score(&identities, self.inputs)?;
        Ok(VariantOutcome {
            identities: Some(identities),
            ..VariantOutcome::new(Variant::PooledVote, scores)
        })
    }

    /// Identities that each Gaussian learns by itself.
    fn per_gaussian(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let config = &self.inputs.config.segmentation;
        let classes = self.inputs.scene.classes.len();
        let size = [self.inputs.gaussians.len(), classes];
        let plan = plan(Variant::PerGaussian, self.inputs)?;
        self.views.use_raw_labels();
        let device = self.inputs.device.clone().autodiff();
        let model = PerGaussian::new(size, config.blend, &device);
        let rate = LR_PER_GAUSSIAN;
        let training = Training::new(model, Adam::new(rate, None), classes);
        self.trained(Variant::PerGaussian, training, &plan, rate, progress)
    }

    /// Gaussian Grouping.
    fn grouping(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let plan = plan(Variant::Grouping, self.inputs)?;
        self.views.use_raw_labels();
        let device = self.inputs.device.clone().autodiff();
        let model = Grouping::new(self.inputs, &device)?;
        let classes = self.inputs.scene.classes.len();
        let training = Training::new(model, Adam::new(LR_GROUPING, None), classes);
        self.trained(Variant::Grouping, training, &plan, LR_GROUPING, progress)
    }

    /// Feature 3DGS: distillation, then a linear head on the raw labels.
    fn distilled(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let inputs = self.inputs;
        let plan = plan(Variant::Distilled, inputs)?;
        let device = inputs.device.clone().autodiff();
        let Some(distilled) = distil(inputs, &device, progress)? else {
            return Ok(VariantOutcome::new(
                Variant::Distilled,
                HeldOutScores::default(),
            ));
        };
        self.views.use_raw_labels();
        let head = LinearHead::new(&distilled.field, inputs, &device);
        let adam = Adam::new(LR_LINEAR_HEAD, None);
        let training = Training::new(head, adam, inputs.scene.classes.len());
        let mut outcome = self.trained(
            Variant::Distilled,
            training,
            &plan,
            LR_LINEAR_HEAD,
            progress,
        )?;
        outcome.seconds += distilled.seconds;
        outcome.learnable_bytes += distilled.field.bytes();
        if inputs.scores_fields && outcome.identities.is_some() {
            outcome.field = Some(distilled.scores(inputs)?);
        }
        Ok(outcome)
    }

    /// The losses of Panoptic Lifting.
    fn panoptic_lifting(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let plan = plan(Variant::PanopticLifting, self.inputs)?;
        self.views.use_raw_labels();
        let device = self.inputs.device.clone().autodiff();
        let model = PanopticLifting::new(self.inputs, plan.iterations, &device);
        let classes = self.inputs.scene.classes.len();
        let training = Training::new(model, Adam::new(LR_PER_GAUSSIAN, None), classes);
        let variant = Variant::PanopticLifting;
        self.trained(variant, training, &plan, LR_PER_GAUSSIAN, progress)
    }

    /// A decoder (Eq. 7).
    fn decoder(&mut self, variant: Variant, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let inputs = self.inputs;
        let plan = plan(variant, inputs)?;
        let input = self.encodings(variant)?.decoder_input(variant, inputs)?;
        let prior = self.evidence.prior()?;
        match self.evidence.prior_kind() {
            Prior::Pooled => {
                let pooled = self.evidence.pooled()?.identities.clone();
                self.views.use_labels_of(&pooled, inputs.device);
            }
            Prior::None | Prior::Votes => self.views.use_raw_labels(),
        }
        let training = decoder_training(variant, &plan, &input, prior, inputs, self.views.len());
        let rate = inputs.config.segmentation.lr;
        let mut outcome = self.trained(variant, training, &plan, rate, progress)?;
        if variant.reads_lifted_features() && outcome.identities.is_some() {
            outcome.field = self.lifted()?;
        }
        self.fine_tuned(outcome, &plan, progress)
    }

    /// Scores of the lifted features, computed once, where they are asked for.
    fn lifted(&self) -> Result<Option<FieldScores>> {
        if let Some(scores) = self.lifted.get() {
            return Ok(*scores);
        }
        let scores = if self.inputs.scores_fields {
            FieldScores::of_lifted(self.inputs)?
        } else {
            None
        };
        Ok(*self.lifted.get_or_init(|| scores))
    }

    /// `outcome` of a decoder trained by `plan`, after the fine-tuning that the settings ask for.
    fn fine_tuned(
        &mut self,
        mut outcome: VariantOutcome,
        plan: &TrainingPlan,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let is_wanted = self.evidence.wants_fine_tuning()?;
        let Some(decoded) = outcome.identities.take_if(|_| is_wanted) else {
            return Ok(outcome);
        };
        self.views.use_raw_labels();
        let fine_tuning = FineTuning::after(plan, self.views.len());
        let device = self.inputs.device.clone().autodiff();
        let model = PerGaussian::starting_at(&decoded, VOTE_FLOOR, &device);
        let adam = Adam::new(fine_tuning.rate, None);
        let training = Training::new(model, adam, decoded.classes);
        drop(decoded);
        let schedule = TrainingSchedule {
            variant: "fine-tuning",
            eval_every: fine_tuning.plan.iterations,
            checkpoint: None,
            ..schedule(outcome.variant, self.inputs, self.checkpoints)?
        };
        let tuned = self.run(
            outcome.variant,
            training,
            &fine_tuning.plan,
            &schedule,
            progress,
        )?;
        outcome.identities = tuned.identities;
        outcome.scores = tuned.scores;
        outcome.fine_tuning_steps = Some(fine_tuning.plan.iterations);
        outcome.seconds += tuned.seconds;
        outcome.learnable_bytes += tuned.learnable_bytes;
        Ok(outcome)
    }

    /// The encodings of the Gaussians (Eq. 6) by the weights that `variant` uses.
    fn encodings(&mut self, variant: Variant) -> Result<&Encodings> {
        let spatial = spatial_of(variant, self.inputs.config);
        let encodings = match self.encodings.take() {
            Some((of, encodings)) if of == spatial => encodings,
            _ => encode(self.inputs, &spatial)?,
        };
        if variant != Variant::RandomSpatial || self.spatial.is_empty() {
            self.spatial.clone_from(&encodings.weights);
        }
        Ok(&self.encodings.insert((spatial, encodings)).1)
    }

    /// Trains by `plan` at learning rate `rate` until `progress` says stop, and scores the identities.
    fn trained<M: IdentityModel>(
        &mut self,
        variant: Variant,
        training: Training<M>,
        plan: &TrainingPlan,
        rate: f64,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let schedule = schedule(variant, self.inputs, self.checkpoints)?;
        let outcome = self.run(variant, training, plan, &schedule, progress)?;
        Ok(VariantOutcome {
            rate: Some(rate),
            ..outcome
        })
    }

    /// Runs `training` by `plan` and `schedule` until `progress` says stop, and scores the identities.
    fn run<M: IdentityModel>(
        &mut self,
        variant: Variant,
        mut training: Training<M>,
        plan: &TrainingPlan,
        schedule: &TrainingSchedule,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let (held_out, inputs) = (&self.held_out, self.inputs);
        // Of the last iteration.
        let mut last: Option<(Identities, HeldOutScores)> = None;
        let mut evaluate = |training: &Training<M>| {
            if held_out.is_empty() {
                return Ok(None);
            }
            let identities = training.identities()?;
            let scores = held_out.score(&identities, inputs)?;
            let miou = scores.miou();
            if training.iteration() == plan.iterations {
                last = Some((identities, scores));
            }
            Ok(miou)
        };
        let finished = training.run(&mut self.views, plan, schedule, &mut evaluate, progress)?;
        if finished && last.is_none() {
            let identities = training.identities()?;
            let scores = held_out.score(&identities, inputs)?;
            last = Some((identities, scores));
        }
        let (identities, scores) = last.unzip();
        Ok(VariantOutcome {
            identities,
            learnable_bytes: training.learnable_bytes(),
            seconds: training.curve.last().map_or(0.0, |p| p.seconds),
            earlier_seconds: training.earlier_seconds,
            curve: training.curve,
            ..VariantOutcome::new(variant, scores.unwrap_or_default())
        })
    }
}
