//! The variants of the label table: what each is, and its training and scoring.

use super::encode::{Encodings, Inputs, encode, spatial_of};
use super::evaluate::{FieldScores, HeldOut, HeldOutScores};
use super::rivals::{Grouping, LinearHead, PanopticLifting, distil};
use super::train_decoder::{
    Adam, IdentityModel, PerGaussian, Training, TrainingPlan, TrainingViews,
};
use super::variant_outcome::VariantOutcome;
use super::variant_training::{decoder_training, plan, schedule};
use super::vote_share::{best_share, mixed};
use crate::config::{Association, Prior, SpatialConfig, Variant};
use crate::data::Split;
use crate::error::Result;
use crate::objects::{Identities, PooledVote, Votes, pooled_vote, refined_vote, vote};
use crate::progress::{Event, Progress};
use std::cell::OnceCell;
use std::path::Path;
use std::time::Instant;

/// Learning rate of per-Gaussian identities.
const LR_PER_GAUSSIAN: f64 = 5e-2;
/// Learning rates of Gaussian Grouping and of the linear head of Feature 3DGS, the best on the built-in room of 0.01 to 0.2 and of
/// 0.01 to 0.1.
const LR_GROUPING: f64 = 0.1;
const LR_LINEAR_HEAD: f64 = 0.1;
/// Share added to every class of the votes that a decoder starts from. A larger one makes confident votes uncertain, and the decoder
/// learns to be certain again at the expense of rare classes.
const VOTE_FLOOR: f32 = 0.002;

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
            progress.event(&Event::Scored {
                variant: variant.title(),
                miou: outcome.scores.miou(),
            });
        }
        stopped = variant != Variant::Raw && outcome.identities.is_none();
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
    votes: OnceCell<Votes>,
    pooled: OnceCell<PooledVote>,
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
            votes: OnceCell::new(),
            pooled: OnceCell::new(),
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
        let identities = self.votes()?.identities();
        let scores = self.held_out.score(&identities, self.inputs)?;
        Ok(VariantOutcome {
            identities: Some(identities),
            ..VariantOutcome::new(Variant::Vote, scores)
        })
    }

    /// The vote, pooled over superpoints and calibrated.
    fn pooled_vote(&self) -> Result<VariantOutcome> {
        let identities = self.pooled()?.identities.clone();
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
        let prior = self.prior()?;
        match self.prior_kind() {
            Prior::Pooled => {
                let pooled = self.pooled()?.identities.clone();
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
        self.with_votes(outcome)
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

    /// `outcome` with the share of the vote that the settings ask for.
    fn with_votes(&self, mut outcome: VariantOutcome) -> Result<VariantOutcome> {
        let Some(trained) = &outcome.identities else {
            return Ok(outcome);
        };
        let start = Instant::now();
        let config = &self.inputs.config.segmentation;
        let share = match config.vote_share {
            Some(share) => share as f32,
            None if self.votes_are_compared()? => best_share(trained, self.votes()?, self.inputs)?,
            None => 0.0,
        };
        if share > 0.0 {
            let identities = mixed(trained, self.votes()?, share, config.blend);
            outcome.scores = self.held_out.score(&identities, self.inputs)?;
            outcome.identities = Some(identities);
        }
        outcome.vote_share = Some(f64::from(share));
        outcome.seconds += start.elapsed().as_secs_f64();
        Ok(outcome)
    }

    /// Whether raw labels decide on the share of the vote. They cannot where they name frequent classes too often: the vote agrees
    /// with that.
    fn votes_are_compared(&self) -> Result<bool> {
        Ok(match self.prior_kind() {
            Prior::None => false,
            Prior::Votes => true,
            Prior::Pooled => self.pooled()?.exponent == 0.0,
        })
    }

    /// What decoders start from. Votes for objects of association are not pooled: two of them may share a superpoint.
    fn prior_kind(&self) -> Prior {
        let config = self.inputs.config;
        let objects = config.data.association == Association::Gaussians;
        match config.segmentation.prior {
            Prior::Pooled if objects => Prior::Votes,
            prior => prior,
        }
    }

    /// The scores that a decoder starts from, `[N, C]`.
    fn prior(&self) -> Result<Option<Vec<f32>>> {
        match self.prior_kind() {
            Prior::None => Ok(None),
            Prior::Votes => Ok(Some(self.votes()?.log_shares(VOTE_FLOOR))),
            Prior::Pooled => {
                let probabilities = self.pooled()?.identities.scores.iter();
                Ok(Some(probabilities.map(|p| (p + VOTE_FLOOR).ln()).collect()))
            }
        }
    }

    /// The votes of the training views, counted once.
    fn votes(&self) -> Result<&Votes> {
        if let Some(votes) = self.votes.get() {
            return Ok(votes);
        }
        let votes = vote(
            self.inputs.gaussians,
            self.inputs.scene.split(Split::Train),
            &self.inputs.scene.classes,
            &self.inputs.settings,
            self.inputs.device,
        )?;
        Ok(self.votes.get_or_init(|| votes))
    }

    /// The refined, pooled and calibrated votes, made once.
    fn pooled(&self) -> Result<&PooledVote> {
        if let Some(pooled) = self.pooled.get() {
            return Ok(pooled);
        }
        let inputs = self.inputs;
        let refined = refined_vote(
            inputs.gaussians,
            inputs.scene.split(Split::Train),
            &inputs.scene.classes,
            &inputs.settings,
            inputs.device,
        )?;
        let exponent = inputs.config.segmentation.prior_exponent;
        let pooled = pooled_vote(inputs.gaussians, self.votes()?, &refined, exponent)?;
        Ok(self.pooled.get_or_init(|| pooled))
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

    /// Trains by `plan` until `progress` says stop, and scores the identities.
    fn trained<M: IdentityModel>(
        &mut self,
        variant: Variant,
        mut training: Training<M>,
        plan: &TrainingPlan,
        rate: f64,
        progress: &mut dyn Progress,
    ) -> Result<VariantOutcome> {
        let (held_out, inputs) = (&self.held_out, self.inputs);
        let schedule = schedule(variant, inputs, self.checkpoints)?;
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
        let finished = training.run(&mut self.views, plan, &schedule, &mut evaluate, progress)?;
        if finished && last.is_none() {
            let identities = training.identities()?;
            let scores = held_out.score(&identities, inputs)?;
            last = Some((identities, scores));
        }
        let (identities, scores) = last.unzip();
        Ok(VariantOutcome {
            identities,
            learnable_bytes: training.learnable_bytes(),
            rate: Some(rate),
            seconds: training.curve.last().map_or(0.0, |p| p.seconds),
            earlier_seconds: training.earlier_seconds,
            curve: training.curve,
            ..VariantOutcome::new(variant, scores.unwrap_or_default())
        })
    }
}
