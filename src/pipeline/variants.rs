//! The variants of the label table: what each is, and its training and scoring.

use super::encode::{Encodings, encode};
use super::evaluate::{FieldScores, HeldOut, HeldOutScores};
use super::fine_tuning::fine_tuning;
use super::label_evidence::{LabelEvidence, VOTE_FLOOR, once};
use super::rivals::{Codes, Grouping, LinearHead, PanopticLifting, distil};
use super::segmentation_inputs::SegmentationInputs;
use super::train_decoder::{
    Adam, IdentityModel, Logits, PerGaussian, Training, TrainingPlan, TrainingSchedule,
    TrainingViews,
};
use super::variant_outcome::VariantOutcome;
use super::variant_training::{average_from, decoder_training, plan, schedule};
use crate::config::{Blend, Prior, Variant};
use crate::error::Result;
use crate::objects::{Identities, smoothed};
use crate::progress::{Event, Progress, go_on};
use burn::tensor::Device;
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
}

/// Trains and scores the configured variants in order.
///
/// # Errors
/// Those of training, of the encoder's weights, and of checkpoints; [`crate::Error::Stopped`].
pub fn train_variants(
    inputs: &SegmentationInputs,
    checkpoints: &Path,
    progress: &mut dyn Progress,
) -> Result<TrainedVariants> {
    let variants = inputs.config.segmentation.rows();
    let mut stage = StageTwo::new(inputs, checkpoints);
    let mut rows: Vec<VariantOutcome> = Vec::new();
    for &variant in variants {
        // The first variant always runs.
        if !rows.is_empty() {
            go_on(progress)?;
        }
        let outcome = match variant {
            Variant::Raw => stage.raw(),
            Variant::Vote => {
                let identities = stage.evidence.votes()?.identities();
                stage.of_identities(variant, identities)?
            }
            Variant::PooledVote => {
                let identities = stage.evidence.pooled()?.identities.clone();
                stage.of_identities(variant, identities)?
            }
            Variant::PerGaussian => {
                let model = PerGaussian(inputs.config.segmentation.blend);
                stage.of_raw_labels(variant, model, stage.logits(), LR_PER_GAUSSIAN, progress)?
            }
            Variant::Grouping => stage.grouping(progress)?,
            Variant::Distilled => stage.distilled(progress)?,
            Variant::PanopticLifting => {
                let model = PanopticLifting::new(inputs);
                stage.of_raw_labels(variant, model, stage.logits(), LR_PER_GAUSSIAN, progress)?
            }
            Variant::NoDecoder => stage.no_decoder(progress)?,
            _ => stage.decoder(variant, progress)?,
        };
        if let Some(identities) = &outcome.identities {
            let ids = identities.ids(&inputs.scene.classes);
            progress.gaussians(inputs.gaussians, Some(&ids));
        }
        progress.event(&Event::Scored {
            variant: variant.title(),
            miou: outcome.scores.miou(),
        });
        rows.push(outcome);
    }
    Ok(TrainedVariants {
        rows,
        spatial: stage
            .encodings
            .take()
            .map_or_else(String::new, |e| e.weights),
    })
}

/// What the variants share.
struct StageTwo<'a> {
    inputs: &'a SegmentationInputs<'a>,
    /// With autodiff.
    device: Device,
    checkpoints: &'a Path,
    views: TrainingViews<'a>,
    held_out: HeldOut<'a>,
    evidence: LabelEvidence<'a>,
    /// Spatial features of the Gaussians (Eq. 6), made once, where a decoder reads them.
    encodings: OnceCell<Encodings>,
    /// Scores of the lifted features.
    lifted: OnceCell<Option<FieldScores>>,
}

impl<'a> StageTwo<'a> {
    fn new(inputs: &'a SegmentationInputs<'a>, checkpoints: &'a Path) -> Self {
        Self {
            inputs,
            device: inputs.device.clone().autodiff(),
            checkpoints,
            views: inputs.training_views(),
            held_out: HeldOut::new(inputs),
            evidence: LabelEvidence::new(inputs),
            encodings: OnceCell::new(),
            lifted: OnceCell::new(),
        }
    }

    /// The raw labels of the held-out views.
    fn raw(&self) -> VariantOutcome {
        let (scores, void_left_out) = self.held_out.score_raw();
        VariantOutcome {
            void_left_out,
            ..VariantOutcome::new(Variant::Raw, scores)
        }
    }

    /// `identities` of Gaussians, from labels alone.
    fn of_identities(
        &self,
        variant: Variant,
        mut identities: Identities,
    ) -> Result<VariantOutcome> {
        self.inputs.correct(&mut identities.scores);
        let scores = self.held_out.score(&identities)?;
        Ok(VariantOutcome {
            identities: Some(identities),
            ..VariantOutcome::new(variant, scores)
        })
    }

    /// Parameters `module` of `model` that learn the raw labels at learning rate `rate`.
    fn of_raw_labels<M: IdentityModel>(
        &mut self,
        variant: Variant,
        model: M,
        module: M::Module,
        rate: f64,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        self.views.use_raw_labels();
        let plan = plan(variant, self.inputs)?;
        let classes = self.inputs.scene.classes.len();
        let adam = Adam::new(rate, plan.config.batch(), None);
        let training = Training::new(model, module, adam, classes);
        let schedule = schedule(variant, self.inputs, self.checkpoints)?;
        self.trained(variant, training, &plan, &schedule, progress)
    }

    /// Zero logits for each Gaussian and class.
    fn logits(&self) -> Logits {
        let inputs = self.inputs;
        let size = [inputs.gaussians.len(), inputs.scene.classes.len()];
        Logits::zeros(size, &self.device)
    }

    /// Gaussian Grouping.
    fn grouping(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let model = Grouping::new(self.inputs)?;
        let codes = Codes::random(self.inputs, &self.device);
        self.of_raw_labels(Variant::Grouping, model, codes, LR_GROUPING, progress)
    }

    /// Feature 3DGS: distillation, then a linear head on the raw labels.
    fn distilled(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let inputs = self.inputs;
        let variant = Variant::Distilled;
        let distilled = distil(inputs, &self.device, progress)?;
        let model = LinearHead::new(&distilled.field);
        let head = LinearHead::random(inputs, &self.device);
        let mut outcome = self.of_raw_labels(variant, model, head, LR_LINEAR_HEAD, progress)?;
        outcome.seconds += distilled.seconds;
        outcome.learnable_bytes += distilled.field.bytes();
        if inputs.scores_fields {
            outcome.field = Some(distilled.scores(inputs)?);
        }
        Ok(outcome)
    }

    /// A decoder (Eq. 7).
    fn decoder(&mut self, variant: Variant, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let inputs = self.inputs;
        let plan = plan(variant, inputs)?;
        let encodings = once(&self.encodings, || encode(inputs))?;
        let input = encodings.decoder_input(variant, inputs)?;
        let prior = self.evidence.prior()?;
        self.use_labels_of_prior()?;
        let training = decoder_training(&plan, &input, prior, inputs);
        let schedule = schedule(variant, inputs, self.checkpoints)?;
        let mut outcome = self.trained(variant, training, &plan, &schedule, progress)?;
        if variant.reads_lifted_features() {
            outcome.field = self.lifted()?;
        }
        self.finished(outcome, &plan, progress)
    }

    /// Scores of each Gaussian that start at the prior, and learn as a decoder does.
    fn no_decoder(&mut self, progress: &mut dyn Progress) -> Result<VariantOutcome> {
        let inputs = self.inputs;
        let variant = Variant::NoDecoder;
        let plan = plan(variant, inputs)?;
        let classes = inputs.scene.classes.len();
        let logits = match self.evidence.prior()? {
            Some(prior) => Logits::new(prior, classes, &self.device),
            None => self.logits(),
        };
        self.use_labels_of_prior()?;
        let config = &plan.config;
        let adam = Adam::new(LR_PER_GAUSSIAN, config.batch(), average_from(config));
        let training = Training::new(PerGaussian(config.blend), logits, adam, classes);
        let schedule = schedule(variant, inputs, self.checkpoints)?;
        let outcome = self.trained(variant, training, &plan, &schedule, progress)?;
        self.finished(outcome, &plan, progress)
    }

    /// Has the next variant learn what the prior says of the labelled pixels, or raw labels where the prior is not pooled.
    fn use_labels_of_prior(&mut self) -> Result<()> {
        match self.evidence.prior_kind() {
            Prior::Pooled => {
                let pooled = &self.evidence.pooled()?.identities;
                self.views.use_labels_of(pooled, self.inputs.device);
            }
            Prior::None | Prior::Votes => self.views.use_raw_labels(),
        }
        Ok(())
    }

    /// Scores of the lifted features, computed once, where they are asked for.
    fn lifted(&self) -> Result<Option<FieldScores>> {
        if !self.inputs.scores_fields {
            return Ok(None);
        }
        once(&self.lifted, || FieldScores::of_lifted(self.inputs)).copied()
    }

    /// `outcome` of a decoder trained by `plan`, fine-tuned or smoothed where its labels ask for it.
    fn finished(
        &mut self,
        outcome: VariantOutcome,
        plan: &TrainingPlan,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        if self.evidence.wants_fine_tuning()? {
            self.fine_tuned(outcome, plan, progress)
        } else if self.evidence.wants_smoothing() {
            self.smoothed(outcome)
        } else {
            Ok(outcome)
        }
    }

    /// `outcome` after smoothing over surfaces.
    fn smoothed(&self, mut outcome: VariantOutcome) -> Result<VariantOutcome> {
        let Some(decoded) = outcome.identities.take() else {
            return Ok(outcome);
        };
        let votes = self.evidence.votes()?;
        let smoothed = smoothed(self.inputs.gaussians, decoded, &votes)?;
        let scored = self.of_identities(outcome.variant, smoothed)?;
        Ok(VariantOutcome {
            identities: scored.identities,
            scores: scored.scores,
            ..outcome
        })
    }

    /// `outcome` of a decoder trained by `plan`, after each Gaussian corrected its scores by the raw labels in its pixels.
    fn fine_tuned(
        &mut self,
        mut outcome: VariantOutcome,
        plan: &TrainingPlan,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let Some(decoded) = outcome.identities.take() else {
            return Ok(outcome);
        };
        self.views.use_raw_labels();
        let (plan, rate) = &fine_tuning(plan, self.views.len());
        let model = PerGaussian(Blend::Probabilities);
        let logits = Logits::starting_at(&decoded, VOTE_FLOOR, &self.device);
        let adam = Adam::new(*rate, plan.config.batch(), None);
        let training = Training::new(model, logits, adam, decoded.classes);
        drop(decoded);
        let schedule = TrainingSchedule {
            variant: "fine-tuning",
            eval_every: plan.config.iterations,
            checkpoint: None,
            ..schedule(outcome.variant, self.inputs, self.checkpoints)?
        };
        let tuned = self.trained(outcome.variant, training, plan, &schedule, progress)?;
        outcome.identities = tuned.identities;
        outcome.scores = tuned.scores;
        let steps = plan.config.iterations.div_ceil(plan.config.batch());
        outcome.fine_tuning_steps = Some(steps);
        outcome.seconds += tuned.seconds;
        outcome.learnable_bytes += tuned.learnable_bytes;
        Ok(outcome)
    }

    /// Runs `training` by `plan` and `schedule`, and scores the identities.
    fn trained<M: IdentityModel>(
        &mut self,
        variant: Variant,
        mut training: Training<M>,
        plan: &TrainingPlan,
        schedule: &TrainingSchedule,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let held_out = &self.held_out;
        let identities = |training: &Training<M>| -> Result<Identities> {
            let mut identities = training.identities()?;
            self.inputs.correct(&mut identities.scores);
            Ok(identities)
        };
        // Identities and scores of the last iteration.
        let mut last: Option<(Identities, HeldOutScores)> = None;
        let mut evaluate = |training: &Training<M>| {
            if held_out.is_empty() {
                return Ok(None);
            }
            let identities = identities(training)?;
            let scores = held_out.score(&identities)?;
            let miou = scores.miou();
            if training.iteration() == plan.config.iterations {
                last = Some((identities, scores));
            }
            Ok(miou)
        };
        training.run(&mut self.views, plan, schedule, &mut evaluate, progress)?;
        let (identities, scores) = match last {
            Some(last) => last,
            None => {
                let identities = identities(&training)?;
                let scores = held_out.score(&identities)?;
                (identities, scores)
            }
        };
        Ok(VariantOutcome {
            identities: Some(identities),
            learnable_bytes: training.learnable_bytes(),
            rate: Some(training.adam.rate),
            seconds: training.curve.last().map_or(0.0, |p| p.seconds),
            earlier_seconds: training.earlier_seconds,
            curve: training.curve,
            ..VariantOutcome::new(variant, scores)
        })
    }
}
