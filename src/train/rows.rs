//! The rows of the label table: what each is, and its training and scoring.

use super::progress::{CurvePoint, Progress};
use super::provenance::Provenance;
use super::rates::choose_rate;
use super::segmentation::{Fused, FusedPlan, Model, Pace, PerGaussian, Plan, Source, TrainingViews, train};
use super::segmentation_inputs::{Inputs, Spatial};
use crate::config::{Association, Prior, Row, SegmentationConfig};
use crate::data::{LabelMap, Split, View};
use crate::error::Result;
use crate::metrics::{InstanceScores, LabelScores, Void, instance_scores, label_scores};
use crate::objects::{Identities, LabelRule, label_map, vote};
use crate::raster::Projected;
use crate::segmentation::decoder::DecoderConfig;
use crate::segmentation::loss::Kind;
use std::path::Path;
use std::sync::Arc;

/// Share added to every class of the votes that a decoder starts from.
const VOTE_FLOOR: f32 = 0.02;

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
    /// Training curve; empty where nothing was trained.
    pub curve: Vec<CurvePoint>,
    /// Bytes of everything learned.
    pub learnable_bytes: usize,
    /// Learning rate, where there is one.
    pub rate: Option<f64>,
    /// Seconds of training.
    pub seconds: f64,
}

impl RowOutcome {
    /// The row's name in settings and reports.
    pub fn name(&self) -> &'static str {
        self.row.key()
    }

    /// Labels of a view: rendered from the stored identities, or the raw labels themselves.
    pub fn labels(&self, view: &View, projected: &Projected<f32>, inputs: &Inputs) -> Option<LabelMap> {
        match &self.identities {
            Some(identities) => Some(render_labels(projected, identities, inputs)),
            None => view.raw.clone(),
        }
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

/// Bytes of projections of held-out views that are kept between evaluations; the others are made again.
const PROJECTED_BYTES: usize = 512 << 20;

/// Test views with truth, projected once as far as memory allows.
struct HeldOut<'a> {
    views: Vec<(&'a View, Option<Projected<f32>>)>,
    /// Classes are objects that association found: their ids are not those of a truth.
    objects: bool,
}

impl<'a> HeldOut<'a> {
    fn new(inputs: &Inputs<'a>) -> Result<Self> {
        let splats = inputs.gaussians.splats();
        let objects = inputs.config.data.association != Association::None;
        let known = |v: &&View| if objects { v.instances.is_some() } else { v.truth.is_some() };
        let (mut views, mut left) = (Vec::new(), Some(PROJECTED_BYTES));
        for view in inputs.scene.split(Split::Test).filter(known) {
            let mut kept = None;
            if let Some(bytes) = left {
                let projected = Projected::new(&splats, &view.camera, &inputs.settings)?;
                left = bytes.checked_sub(projected.bytes());
                kept = left.map(|_| projected);
            }
            views.push((view, kept));
        }
        Ok(Self { views, objects })
    }

    /// Scores of a row with these identities.
    fn score(&self, identities: &Identities, inputs: &Inputs) -> Result<(LabelScores, Option<InstanceScores>)> {
        let rendered = |(view, projected): &(&View, Option<Projected<f32>>)| match projected {
            Some(projected) => Ok(render_labels(projected, identities, inputs)),
            None => {
                let projected = Projected::new(&inputs.gaussians.splats(), &view.camera, &inputs.settings)?;
                Ok(render_labels(&projected, identities, inputs))
            }
        };
        let predicted: Vec<LabelMap> = self.views.iter().map(rendered).collect::<Result<_>>()?;
        let found = || self.views.iter().zip(&predicted).map(|((view, _), found)| (*view, found));
        Ok((self.labels(found(), inputs, Void::Wrong), self.instances(found())))
    }

    /// Scores of the raw labels of the test views.
    fn score_raw(&self, inputs: &Inputs) -> RowOutcome {
        let raw = || self.views.iter().filter_map(|(view, _)| Some((*view, view.raw.as_ref()?)));
        RowOutcome {
            scores: self.labels(raw(), inputs, Void::Wrong),
            void_left_out: (!self.objects).then(|| self.labels(raw(), inputs, Void::LeftOut)),
            instances: self.instances(raw()),
            ..untrained(Row::Raw)
        }
    }

    fn labels<'m>(
        &self,
        found: impl Iterator<Item = (&'m View, &'m LabelMap)>,
        inputs: &Inputs,
        void: Void,
    ) -> LabelScores {
        let pairs = found.filter_map(|(view, map)| Some((&view.truth.as_ref()?.ids[..], &map.ids[..])));
        label_scores(&inputs.scene.classes, pairs, void)
    }

    fn instances<'m>(&self, found: impl Iterator<Item = (&'m View, &'m LabelMap)>) -> Option<InstanceScores> {
        let pairs = found.filter_map(|(view, map)| Some((&view.instances.as_ref()?.ids[..], &map.ids[..])));
        (self.objects && !self.views.is_empty()).then(|| instance_scores(pairs))
    }
}

/// Trains and scores the configured rows in order; returns them and the name of the point encoder's weights.
///
/// # Errors
/// Those of training, of the encoder's weights, and of checkpoints.
pub fn run_rows(inputs: &Inputs, checkpoints: &Path, progress: &mut dyn Progress) -> Result<(Vec<RowOutcome>, String)> {
    let config = &inputs.config.segmentation;
    let held_out = HeldOut::new(inputs)?;
    let mut views = TrainingViews::new(
        inputs.gaussians,
        inputs.scene.split(Split::Train),
        &inputs.scene.classes,
        inputs.settings,
        config.min_coverage as f32,
        config.weight_cache_mb << 20,
    );
    let mut spatial = Spatial::default();
    let mut rows = Vec::new();
    for &row in &config.rows {
        let outcome = match row {
            Row::Raw => held_out.score_raw(inputs),
            Row::Vote => {
                let train = inputs.scene.split(Split::Train);
                let votes = vote(inputs.gaussians, train, &inputs.scene.classes, &inputs.settings)?;
                let identities = votes.identities();
                let (scores, instances) = held_out.score(&identities, inputs)?;
                RowOutcome { scores, instances, identities: Some(identities), ..untrained(row) }
            }
            _ => trained(row, inputs, &mut views, &mut spatial, &held_out, checkpoints, progress)?,
        };
        rows.push(outcome);
        if progress.stop() {
            break;
        }
    }
    Ok((rows, spatial.name))
}

fn untrained(row: Row) -> RowOutcome {
    RowOutcome {
        row,
        identities: None,
        scores: LabelScores::default(),
        void_left_out: None,
        instances: None,
        curve: Vec::new(),
        learnable_bytes: 0,
        rate: None,
        seconds: 0.0,
    }
}

/// Loss of a row after the warm-up.
fn loss(row: Row, config: &SegmentationConfig) -> Result<Kind> {
    match row {
        Row::PerGaussian | Row::OursCe => Ok(Kind::Ce),
        _ => Kind::from_config(config),
    }
}

fn trained(
    row: Row,
    inputs: &Inputs,
    views: &mut TrainingViews,
    spatial: &mut Spatial,
    held_out: &HeldOut,
    checkpoints: &Path,
    progress: &mut dyn Progress,
) -> Result<RowOutcome> {
    let config = &inputs.config.segmentation;
    let seed = inputs.config.seed;
    let plan = Plan::new(config, loss(row, config)?, seed);
    let tenth = |every: usize| if every == 0 { config.iterations.div_ceil(10) } else { every };
    let pace = Pace {
        row: row.key(),
        eval_every: tenth(config.eval_every),
        checkpoint_every: tenth(config.checkpoint_every),
        checkpoint: Some(checkpoints.join(format!("{}.safetensors", row.key()))),
        provenance: Provenance::row(row, inputs),
    };
    let device = inputs.device.clone().autodiff();
    let classes = inputs.scene.classes.len();
    let mut score = |identities: &Identities| {
        let (labels, instances) = held_out.score(identities, inputs)?;
        Ok(labels.miou.or(instances.and_then(|scores| scores.miou)))
    };
    let rate_file = checkpoints.join(format!("{}.rate.safetensors", row.key()));
    let mut fit = |views: &mut TrainingViews, model: &mut dyn Model, rate: f64| -> Result<RowOutcome> {
        let curve = train(model, views, &plan, &pace, &mut score, progress)?;
        let identities = model.identities()?;
        let (scores, instances) = held_out.score(&identities, inputs)?;
        Ok(RowOutcome {
            scores,
            instances,
            identities: Some(identities),
            learnable_bytes: model.learnable_bytes(),
            rate: Some(rate),
            seconds: curve.last().map_or(0.0, |p| p.seconds),
            curve,
            ..untrained(row)
        })
    };
    if !row.is_fused() {
        let model = |rate| PerGaussian::new([inputs.gaussians.len(), classes], rate, config.blend, &device);
        let mut boxed = |rate, _: &TrainingViews| Ok(Box::new(model(rate)) as Box<dyn Model>);
        let rate = choose_rate(config.lr_per_gaussian, &plan, views, inputs, &rate_file, &mut boxed)?;
        return fit(views, &mut model(rate), rate);
    }
    let source = spatial.source(row, inputs)?;
    let mut boxed = |rate, views: &TrainingViews| -> Result<Box<dyn Model + '_>> {
        Ok(Box::new(decoder_row(row, rate, source, inputs, views)?))
    };
    let rate = choose_rate(config.lr, &plan, views, inputs, &rate_file, &mut boxed)?;
    fit(views, &mut decoder_row(row, rate, source, inputs, views)?, rate)
}

/// The decoder of `row` before its first step at learning rate `rate`, over the frozen inputs `source`; its prior, where
/// settings ask for one, is the votes of the views in use.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite.
pub fn decoder_row<'a>(
    row: Row,
    rate: f64,
    source: &'a Source,
    inputs: &'a Inputs,
    views: &TrainingViews,
) -> Result<Fused<'a>> {
    let config = &inputs.config.segmentation;
    let (seed, classes) = (inputs.config.seed, inputs.scene.classes.len());
    let plan = FusedPlan {
        config,
        rate,
        regularised: row != Row::OursCe && config.lambda_reg > 0.0,
        size: [inputs.gaussians.len(), classes],
        average_from: config.average.then_some((config.warmup * config.iterations as f64) as usize),
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
        Prior::Votes => fused.with_prior(Arc::new(views.votes()?.log_shares(VOTE_FLOOR))),
    })
}
