//! The rows of the label table: what each is, and its training and scoring.

use super::compactness::Compacting;
use super::progress::{CurvePoint, Progress};
use super::provenance::Provenance;
use super::rates::{Rate, choose_rate};
use super::segmentation::{Fused, FusedPlan, Model, Pace, PerGaussian, Plan, Session, Source, TrainingViews, train};
use super::segmentation_inputs::{Inputs, Spatial};
use crate::config::{Association, LabelLoss, Prior, Row, SegmentationConfig};
use crate::data::{LabelMap, LabelRuns, Split, View};
use crate::error::Result;
use crate::metrics::{
    Agreement, Compactness, InstanceScores, LabelScores, SemanticScores, Void, instance_scores, label_scores,
};
use crate::objects::{Identities, LabelRule, Semantics, has_truth, label_map, vote};
use crate::raster::Projected;
use crate::segmentation::decoder::DecoderConfig;
use crate::segmentation::loss::Kind;
use std::borrow::Cow;
use std::path::Path;

/// Share added to every class of the votes that a decoder starts from.
const VOTE_FLOOR: f32 = 0.02;
/// Bytes of projected test views that are kept; others are projected again at each use.
const PROJECTED_BYTES: usize = 1 << 29;

/// One row, trained and scored.
#[derive(Clone, Debug)]
pub struct RowOutcome {
    /// Which.
    pub row: Row,
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
    /// Seconds of trying learning rates, where several were tried.
    pub trial_seconds: Option<f64>,
}

impl RowOutcome {
    /// The row's name in settings and reports.
    pub fn name(&self) -> &'static str {
        self.row.key()
    }
}

impl Row {
    /// Whether the row trains the decoder.
    pub fn is_fused(self) -> bool {
        !matches!(self, Self::Raw | Self::Vote | Self::PerGaussian)
    }
}

fn render_labels(projected: &Projected<f32>, identities: &Identities, inputs: &Inputs) -> LabelMap {
    label_map(projected, identities, &inputs.scene.classes, &LabelRule::from(&inputs.config.segmentation))
}

/// A test view with truth.
struct Known<'a> {
    view: &'a View,
    /// Where it is kept.
    projected: Option<Projected<f32>>,
}

/// Test views with truth, projected once as far as memory allows.
struct HeldOut<'a> {
    views: Vec<Known<'a>>,
    /// Classes are objects that association found: their ids are not those of a truth.
    objects: bool,
    /// The classes of these objects.
    semantics: Option<&'a Semantics>,
}

/// Held-out scores of one row.
#[derive(Default)]
struct Scores {
    labels: LabelScores,
    instances: Option<InstanceScores>,
    semantic: Option<SemanticScores>,
}

impl Scores {
    /// The mIoU of a training curve.
    fn miou(&self) -> Option<f64> {
        let [instances, semantic] =
            [self.instances.as_ref().and_then(|s| s.miou), self.semantic.as_ref().and_then(|s| s.miou)];
        self.labels.miou.or(instances).or(semantic)
    }

    /// A row with these scores.
    fn of(self, row: Row) -> RowOutcome {
        let Self { labels, instances, semantic } = self;
        RowOutcome { scores: labels, instances, semantic, ..untrained(row) }
    }
}

impl<'a> HeldOut<'a> {
    fn new(inputs: &Inputs<'a>) -> Result<Self> {
        let (association, semantics) = (inputs.config.data.association, inputs.semantics);
        let objects = association != Association::None;
        let known = |view: &&View| has_truth(view, association, semantics);
        let mut left = PROJECTED_BYTES;
        let keep = |view| {
            let projected = project(view, inputs)?;
            let rest = left.checked_sub(projected.bytes());
            left = rest.unwrap_or(left);
            Ok(Known { view, projected: rest.map(|_| projected) })
        };
        let views = inputs.scene.split(Split::Test).filter(known).map(keep).collect::<Result<_>>()?;
        Ok(Self { views, objects, semantics })
    }

    /// Scores of a row with these identities.
    fn score(&self, identities: &Identities, inputs: &Inputs) -> Result<Scores> {
        let found = |known: &Known<'a>| {
            let projected = match &known.projected {
                Some(projected) => Cow::Borrowed(projected),
                None => Cow::Owned(project(known.view, inputs)?),
            };
            Ok((known.view, LabelRuns::from(render_labels(&projected, identities, inputs))))
        };
        let found: Vec<_> = self.views.iter().map(found).collect::<Result<_>>()?;
        Ok(self.scores(&found, inputs))
    }

    /// Scores of the raw labels of the test views.
    fn score_raw(&self, inputs: &Inputs) -> RowOutcome {
        let raw: Vec<_> = self.views.iter().filter_map(|known| Some((known.view, known.view.raw.clone()?))).collect();
        let void_left_out = (!self.objects).then(|| self.labels(&raw, inputs, Void::LeftOut));
        RowOutcome { void_left_out, ..self.scores(&raw, inputs).of(Row::Raw) }
    }

    fn scores(&self, found: &[(&View, LabelRuns)], inputs: &Inputs) -> Scores {
        Scores {
            labels: self.labels(found, inputs, Void::Wrong),
            instances: self.instances(found),
            semantic: self.semantics.map(|semantics| semantics.score(&inputs.scene.classes, found)),
        }
    }

    /// Against true labels, as far as there are any.
    fn labels(&self, found: &[(&View, LabelRuns)], inputs: &Inputs, void: Void) -> LabelScores {
        let pairs = found.iter().filter_map(|(view, found)| Some((view.truth.as_ref()?.map(), found.map())));
        label_scores(&inputs.scene.classes, pairs, void)
    }

    /// Against true instances, where classes are objects.
    fn instances(&self, found: &[(&View, LabelRuns)]) -> Option<InstanceScores> {
        let pairs = found.iter().filter_map(|(view, found)| Some((view.instances.as_ref()?.map(), found.map())));
        let known = self.views.iter().any(|known| known.view.instances.is_some());
        (self.objects && known).then(|| instance_scores(pairs))
    }
}

fn project(view: &View, inputs: &Inputs) -> Result<Projected<f32>> {
    Projected::new(&inputs.gaussians.splats(), &view.camera, &inputs.settings)
}

/// Rows, trained and scored.
pub struct TrainedRows {
    /// In the order of the configuration.
    pub rows: Vec<RowOutcome>,
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
    outcome: RowOutcome,
    /// Seconds of training that earlier parts of a resumed run took.
    earlier: f64,
    /// Whether it came to its end.
    whole: bool,
}

/// Trains and scores the configured rows in order, until `progress` says stop.
///
/// # Errors
/// Those of training, of the encoder's weights, and of checkpoints.
pub fn run_rows(inputs: &Inputs, checkpoints: &Path, progress: &mut dyn Progress) -> Result<TrainedRows> {
    let config = &inputs.config.segmentation;
    let held_out = HeldOut::new(inputs)?;
    let mut views = inputs.training_views();
    let compacting = Compacting::new(inputs)?;
    let mut spatial = Spatial::default();
    let (mut rows, mut earlier, mut stopped) = (Vec::new(), 0.0, false);
    for &row in config.rows() {
        let outcome = match row {
            Row::Raw => held_out.score_raw(inputs),
            Row::Vote => {
                let train = inputs.scene.split(Split::Train);
                let votes = vote(inputs.gaussians, train, &inputs.scene.classes, &inputs.settings)?;
                let identities = votes.identities();
                let scores = held_out.score(&identities, inputs)?;
                RowOutcome { identities: Some(identities), agreement: Some(votes.agreement()), ..scores.of(row) }
            }
            _ => {
                let Trained { outcome, earlier: before, whole } =
                    trained(row, inputs, &mut views, &mut spatial, &held_out, checkpoints, progress)?;
                earlier += before;
                if !whole {
                    rows.push(outcome);
                    stopped = true;
                    break;
                }
                outcome
            }
        };
        rows.push(compacting.finish(outcome, |identities, row| {
            let Scores { labels, instances, semantic } = held_out.score(identities, inputs)?;
            Ok(RowOutcome { scores: labels, instances, semantic, ..row })
        })?);
        // Where nothing is left there is nothing to stop.
        stopped = rows.len() < config.rows().len() && progress.stop();
        if stopped {
            break;
        }
    }
    Ok(TrainedRows { rows, spatial: spatial.name, earlier, stopped })
}

fn untrained(row: Row) -> RowOutcome {
    RowOutcome {
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
        trial_seconds: None,
    }
}

/// Loss of a row after the warm-up.
fn loss(row: Row, config: &SegmentationConfig) -> Result<Kind> {
    match row {
        Row::PerGaussian | Row::OursCe => Ok(Kind::Ce),
        _ => Kind::from_config(config),
    }
}

/// Trains `row` and scores it.
fn trained(
    row: Row,
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
    let tenth = |every: usize| if every == 0 { config.iterations.div_ceil(10) } else { every };
    let pace = Pace {
        row: row.key(),
        eval_every: tenth(config.eval_every),
        checkpoint_every: tenth(config.checkpoint_every),
        checkpoint: Some(checkpoints.join(format!("{}.safetensors", row.key()))),
        provenance: Provenance::row(row, inputs)?,
    };
    let device = inputs.device.clone().autodiff();
    let classes = inputs.scene.classes.len();
    let mut score = |identities: &Identities| Ok(held_out.score(identities, inputs)?.miou());
    let mut fit = |views: &mut TrainingViews, model: &mut dyn Model, rate: &Rate, progress: &mut dyn Progress| {
        let Session { curve, earlier, whole } = train(model, views, &plan, &pace, &mut score, progress)?;
        let (identities, scores) = match whole {
            true => {
                let identities = model.identities()?;
                let scores = held_out.score(&identities, inputs)?;
                (Some(identities), scores)
            }
            false => (None, Scores::default()),
        };
        let outcome = RowOutcome {
            identities,
            learnable_bytes: model.learnable_bytes(),
            rate: Some(rate.rate),
            trial_seconds: rate.seconds,
            seconds: curve.last().map_or(0.0, |p| p.seconds),
            curve,
            ..scores.of(row)
        };
        Ok(Trained { outcome, earlier: earlier + rate.earlier, whole })
    };
    let stopped = || Trained { outcome: untrained(row), earlier: 0.0, whole: false };
    if !row.is_fused() {
        let model = |rate| PerGaussian::new([inputs.gaussians.len(), classes], rate, config.blend, &device);
        let mut boxed = |rate, _: &Plan, _: &TrainingViews| Ok(Box::new(model(rate)) as Box<dyn Model>);
        let rate = choose_rate(config.lr_per_gaussian, &plan, views, inputs, &pace, &mut boxed, progress)?;
        let Some(rate) = rate else { return Ok(stopped()) };
        return fit(views, &mut model(rate.rate), &rate, progress);
    }
    let source = spatial.source(row, inputs)?;
    let mut boxed = |rate, plan: &Plan, views: &TrainingViews| -> Result<Box<dyn Model + '_>> {
        Ok(Box::new(decoder_row(row, rate, plan, source, inputs, views)?))
    };
    let rate = choose_rate(config.lr, &plan, views, inputs, &pace, &mut boxed, progress)?;
    let Some(rate) = rate else { return Ok(stopped()) };
    fit(views, &mut decoder_row(row, rate.rate, &plan, source, inputs, views)?, &rate, progress)
}

/// The decoder of `row` before its first step at learning rate `rate`, over the frozen inputs `source`; its prior, where
/// settings ask for one, is the votes of the views in use. Where its parameters are averaged, that begins after the share
/// `segmentation.warmup` of the iterations of `plan`, which may be a trial's.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
pub fn decoder_row<'a>(
    row: Row,
    rate: f64,
    plan: &Plan,
    source: &'a Source,
    inputs: &'a Inputs,
    views: &TrainingViews,
) -> Result<Fused<'a>> {
    let config = &inputs.config.segmentation;
    let (seed, classes) = (inputs.config.seed, inputs.scene.classes.len());
    // Not `plan.warmup`: a row under cross-entropy has no warm-up, and is averaged over the same steps as the others.
    let average_from = (config.warmup * plan.iterations as f64) as usize;
    let plan = FusedPlan {
        config,
        rate,
        regularised: row != Row::OursCe && config.lambda_reg > 0.0,
        size: [inputs.gaussians.len(), classes],
        dropout: (row != Row::OursCe && config.loss == LabelLoss::Gjs).then_some(config.gjs_dropout),
        average_from: config.average.then_some(average_from),
        seed,
    };
    let device = inputs.device.clone().autodiff();
    let pyramid = &source.scene().pyramid;
    let decoder = DecoderConfig::for_pyramid(pyramid, classes, pyramid.levels.len() > 1)
        .with_layer_norm(config.layer_norm)
        .with_seed(seed)
        .init(&device);
    let fused = Fused::new(decoder, source, &inputs.gaussians.means, views.len(), plan, &device);
    Ok(match config.prior {
        Prior::None => fused,
        Prior::Votes => fused.with_prior(views.votes()?.log_shares(VOTE_FLOOR)),
    })
}
