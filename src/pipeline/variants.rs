//! The rows of the label table: what each is, and its training and scoring.

use super::encode::{Inputs, Spatial};
use super::evaluate::{HeldOut, NeighbourAgreement, Scores};
use super::train_decoder::{
    DecoderInput, DecoderModel, DecoderPlan, IdentityModel, PerGaussian, Plan, Schedule,
    TrainingRun, TrainingViews, train_decoder,
};
use crate::config::{Prior, SegmentationConfig, Variant};
use crate::error::Result;
use crate::metrics::{Agreement, Compactness, InstanceScores, LabelScores, SemanticScores};
use crate::objects::Identities;
use crate::progress::{CurvePoint, Progress};
use crate::provenance::Provenance;
use crate::segmentation::decoder::DecoderConfig;
use crate::segmentation::encoder::spatial_digest;
use crate::segmentation::loss::LabelLoss;
use std::path::Path;

/// Learning rate of per-Gaussian identities.
const LR_PER_GAUSSIAN: f64 = 5e-2;
/// Share added to every class of the votes that a decoder starts from.
const VOTE_FLOOR: f32 = 0.02;
/// Share of the frozen channels that each of the two predictions of `loss = "gjs"` drops.
const GJS_DROPOUT: f64 = 0.2;

/// One row, trained and scored.
#[derive(Clone, Debug)]
pub struct VariantOutcome {
    /// Which.
    pub row: Variant,
    /// What the Gaussians store; none for the raw labels themselves.
    pub identities: Option<Identities>,
    /// Held-out scores, void predictions counted as wrong.
    pub scores: LabelScores,
    /// Held-out scores with void predictions left out; raw labels only.
    pub void_left_out: Option<LabelScores>,
    /// Held-out scores against true instances, where classes are objects that association found.
    pub instances: Option<InstanceScores>,
    /// Held-out scores against true classes, where these objects have classes.
    pub semantic: Option<SemanticScores>,
    /// How compact the identities are.
    pub compactness: Option<Compactness>,
    /// How far the raw labels agree about the Gaussians; of the vote.
    pub agreement: Option<Agreement>,
    /// Training curve; empty where nothing was trained.
    pub curve: Vec<CurvePoint>,
    /// Bytes of everything learned.
    pub learnable_bytes: usize,
    /// Learning rate, where there is one.
    pub rate: Option<f64>,
    /// Seconds of training.
    pub seconds: f64,
}

impl VariantOutcome {
    /// The row's name in settings and reports.
    pub fn name(&self) -> &'static str {
        self.row.key()
    }

    /// The same with these scores.
    fn scored(
        self,
        Scores {
            labels,
            instances,
            semantic,
        }: Scores,
    ) -> Self {
        Self {
            scores: labels,
            instances,
            semantic,
            ..self
        }
    }
}

/// Rows, trained and scored.
pub struct TrainedRows {
    /// In the order of the configuration.
    pub rows: Vec<VariantOutcome>,
    /// Name of the point encoder's weights.
    pub spatial: String,
    /// Seconds of training that earlier parts of a resumed run took.
    pub earlier: f64,
    /// Whether `progress` said stop before all rows were done.
    pub stopped: bool,
}

/// A row, trained as far as `progress` let it.
struct Trained {
    /// Has neither identities nor scores where it was stopped before its end.
    outcome: VariantOutcome,
    /// Seconds of training that earlier parts of a resumed run took.
    earlier: f64,
    /// Whether it came to its end.
    whole: bool,
}

/// Trains and scores the configured rows in order, until `progress` says stop.
///
/// # Errors
/// Those of training, of the encoder's weights, and of checkpoints.
pub fn run_rows(
    inputs: &Inputs,
    checkpoints: &Path,
    progress: &mut dyn Progress,
) -> Result<TrainedRows> {
    let config = &inputs.config.segmentation;
    let held_out = HeldOut::new(inputs)?;
    let mut views = inputs.training_views();
    let neighbours = NeighbourAgreement::new(inputs)?;
    let mut spatial = Spatial::default();
    let (mut rows, mut earlier, mut stopped) = (Vec::new(), 0.0, false);
    for (number, &row) in config.rows().iter().enumerate() {
        // A table of votes takes as much as identities do.
        let votes = |row: &Variant| {
            *row == Variant::Vote || row.trains_decoder() && config.prior == Prior::Votes
        };
        views.keep_votes(config.rows()[number + 1..].iter().any(votes));
        let outcome = match row {
            Variant::Raw => {
                let (scores, void_left_out) = held_out.score_raw(inputs);
                VariantOutcome {
                    void_left_out,
                    ..untrained(row).scored(scores)
                }
            }
            Variant::Vote => {
                let votes = views.votes()?;
                let (identities, agreement) = (votes.identities(), Some(votes.agreement()));
                let scores = held_out.score(&identities, inputs)?;
                VariantOutcome {
                    identities: Some(identities),
                    agreement,
                    ..untrained(row).scored(scores)
                }
            }
            _ => {
                let Trained {
                    outcome,
                    earlier: before,
                    whole,
                } = trained(
                    row,
                    inputs,
                    &mut views,
                    &mut spatial,
                    &held_out,
                    checkpoints,
                    progress,
                )?;
                earlier += before;
                if !whole {
                    rows.push(outcome);
                    stopped = true;
                    break;
                }
                outcome
            }
        };
        rows.push(VariantOutcome {
            compactness: outcome.identities.as_ref().map(|i| neighbours.of(i)),
            ..outcome
        });
        // Where nothing is left there is nothing to stop.
        stopped = rows.len() < config.rows().len() && progress.stop();
        if stopped {
            break;
        }
    }
    Ok(TrainedRows {
        rows,
        spatial: spatial.name,
        earlier,
        stopped,
    })
}

fn untrained(row: Variant) -> VariantOutcome {
    VariantOutcome {
        row,
        identities: None,
        scores: LabelScores::default(),
        void_left_out: None,
        instances: None,
        semantic: None,
        compactness: None,
        agreement: None,
        curve: Vec::new(),
        learnable_bytes: 0,
        rate: None,
        seconds: 0.0,
    }
}

/// Loss of a row after the warm-up.
fn loss(row: Variant, config: &SegmentationConfig) -> Result<LabelLoss> {
    match row {
        Variant::PerGaussian | Variant::OursCe => Ok(LabelLoss::Ce),
        _ => LabelLoss::from_config(config),
    }
}

/// What the training of `variant` follows from.
///
/// # Errors
/// [`crate::Error::Io`] when the file of the point encoder's weights cannot be read.
fn provenance(variant: Variant, inputs: &Inputs) -> Result<Provenance> {
    let decoder = variant.trains_decoder();
    let mut provenance =
        Provenance::stage_two(inputs.config, inputs.scene, inputs.gaussians, decoder);
    if let Some(lifted) = &inputs.lifted
        && decoder
        && variant != Variant::NoImageFeatures
    {
        provenance = provenance.with_image_features(&lifted.content);
    }
    if decoder
        && !matches!(variant, Variant::NoSpatial | Variant::RandomSpatial)
        && let Some(weights) = spatial_digest(&inputs.config.spatial)?
    {
        provenance = provenance.with_point_encoder(&weights);
    }
    Ok(provenance)
}

/// Trains `row` and scores it.
fn trained(
    row: Variant,
    inputs: &Inputs,
    views: &mut TrainingViews,
    spatial: &mut Spatial,
    held_out: &HeldOut,
    checkpoints: &Path,
    progress: &mut dyn Progress,
) -> Result<Trained> {
    let config = &inputs.config.segmentation;
    let seed = inputs.config.seed;
    let plan = Plan::new(config, loss(row, config)?, seed);
    let tenth = |every: usize| {
        if every == 0 {
            config.iterations.div_ceil(10)
        } else {
            every
        }
    };
    let schedule = Schedule {
        variant: row.key(),
        eval_every: tenth(config.eval_every),
        checkpoint_every: tenth(config.checkpoint_every),
        checkpoint: Some(checkpoints.join(format!("{}.safetensors", row.key()))),
        provenance: provenance(row, inputs)?,
    };
    let device = inputs.device.clone().autodiff();
    let classes = inputs.scene.classes.len();
    let fit = |views: &mut TrainingViews,
               model: &mut dyn IdentityModel,
               rate: f64,
               progress: &mut dyn Progress| {
        // Of the end of training, which asks for nothing anew.
        let mut last: Option<(Identities, Scores)> = None;
        let mut score = |model: &mut dyn IdentityModel, iteration| {
            if held_out.is_empty() {
                return Ok(None);
            }
            let identities = model.identities()?;
            let scores = held_out.score(&identities, inputs)?;
            let miou = scores.miou();
            if iteration == plan.iterations {
                last = Some((identities, scores));
            }
            Ok(miou)
        };
        let TrainingRun {
            curve,
            earlier_seconds: earlier,
            finished: whole,
        } = train_decoder(model, views, &plan, &schedule, &mut score, progress)?;
        let (identities, scores) = match (whole, last.take()) {
            (true, Some((identities, scores))) => (Some(identities), scores),
            (true, None) => {
                let identities = model.identities()?;
                let scores = held_out.score(&identities, inputs)?;
                (Some(identities), scores)
            }
            (false, _) => (None, Scores::default()),
        };
        let outcome = VariantOutcome {
            identities,
            learnable_bytes: model.learnable_bytes(),
            rate: Some(rate),
            seconds: curve.last().map_or(0.0, |p| p.seconds),
            curve,
            ..untrained(row).scored(scores)
        };
        Ok(Trained {
            outcome,
            earlier,
            whole,
        })
    };
    if !row.trains_decoder() {
        let size = [inputs.gaussians.len(), classes];
        let mut model = PerGaussian::new(size, LR_PER_GAUSSIAN, config.blend, &device);
        return fit(views, &mut model, LR_PER_GAUSSIAN, progress);
    }
    let source = spatial.source(row, inputs)?;
    let mut model = decoder_row(row, config.lr, &plan, source, inputs, views)?;
    fit(views, &mut model, config.lr, progress)
}

/// The decoder of `row` before its first step at learning rate `rate`, over the frozen inputs `source`; its prior, where
/// settings ask for one, is the votes of the views in use. Where its parameters are averaged, that begins after the share
/// `segmentation.warmup` of the iterations of `plan`.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
pub fn decoder_row<'a>(
    row: Variant,
    rate: f64,
    plan: &Plan,
    source: &'a DecoderInput,
    inputs: &'a Inputs,
    views: &mut TrainingViews,
) -> Result<DecoderModel<'a>> {
    let config = &inputs.config.segmentation;
    let (seed, classes) = (inputs.config.seed, inputs.scene.classes.len());
    // Not `plan.warmup`: a row under cross-entropy has no warm-up, and is averaged over the same steps as the others.
    let average_from = (config.warmup * plan.iterations as f64) as usize;
    let dropout = matches!(plan.loss, LabelLoss::Gjs { .. }).then_some(GJS_DROPOUT);
    let plan = DecoderPlan {
        config,
        rate,
        regularised: row != Variant::OursCe && config.lambda_reg > 0.0,
        size: [inputs.gaussians.len(), classes],
        dropout,
        average_from: config.average.then_some(average_from),
        seed,
    };
    let device = inputs.device.clone().autodiff();
    let pyramid = &source.scene().pyramid;
    let decoder = DecoderConfig::for_pyramid(pyramid, classes, pyramid.levels.len() > 1)
        .with_seed(seed)
        .init(&device);
    let fused = DecoderModel::new(
        decoder,
        source,
        &inputs.gaussians.means,
        views.len(),
        plan,
        &device,
    );
    Ok(match config.prior {
        Prior::None => fused,
        Prior::Votes => fused.with_prior(views.votes()?.log_shares(VOTE_FLOOR)),
    })
}
