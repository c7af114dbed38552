//! The rows of the label table: what each is, and its training and scoring.

use super::progress::{CurvePoint, Progress};
use super::segmentation::{Fused, FusedPlan, Model, Pace, PerGaussian, Plan, Source, TrainingViews, train};
use super::segmentation_inputs::{Inputs, Spatial};
use crate::config::{Row, SegmentationConfig};
use crate::data::{LabelMap, Split, View};
use crate::error::Result;
use crate::metrics::{LabelScores, Void, label_scores};
use crate::objects::{Identities, label_map, vote};
use crate::raster::Projected;
use crate::segmentation::decoder::DecoderConfig;
use crate::segmentation::loss::Kind;
use std::path::Path;

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
    label_map(projected, identities, &inputs.scene.classes, inputs.config.segmentation.min_coverage as f32)
}

/// Test views with truth, projected once.
struct HeldOut<'a>(Vec<(&'a View, &'a LabelMap, Projected<f32>)>);

impl<'a> HeldOut<'a> {
    fn new(inputs: &Inputs<'a>) -> Result<Self> {
        let splats = inputs.gaussians.splats();
        let views = inputs.scene.split(Split::Test).filter_map(|v| Some((v, v.truth.as_ref()?)));
        let project = |(view, truth): (&'a View, &'a LabelMap)| {
            Ok((view, truth, Projected::new(&splats, &view.camera, &inputs.settings)?))
        };
        Ok(Self(views.map(project).collect::<Result<_>>()?))
    }

    fn score(&self, identities: &Identities, inputs: &Inputs) -> LabelScores {
        let predicted: Vec<LabelMap> = self.0.iter().map(|(_, _, p)| render_labels(p, identities, inputs)).collect();
        let pairs = self.0.iter().zip(&predicted).map(|((_, truth, _), p)| (&truth.ids[..], &p.ids[..]));
        label_scores(&inputs.scene.classes, pairs, Void::Wrong)
    }

    fn score_raw(&self, inputs: &Inputs, void: Void) -> LabelScores {
        let pairs = self.0.iter().filter_map(|(v, truth, _)| Some((&truth.ids[..], &v.raw.as_ref()?.ids[..])));
        label_scores(&inputs.scene.classes, pairs, void)
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
            Row::Raw => RowOutcome {
                scores: held_out.score_raw(inputs, Void::Wrong),
                void_left_out: Some(held_out.score_raw(inputs, Void::LeftOut)),
                ..untrained(row)
            },
            Row::Vote => {
                let train = inputs.scene.split(Split::Train);
                let votes = vote(inputs.gaussians, train, &inputs.scene.classes, &inputs.settings)?;
                let identities = votes.identities();
                RowOutcome {
                    scores: held_out.score(&identities, inputs),
                    identities: Some(identities),
                    ..untrained(row)
                }
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
    };
    let device = inputs.device.clone().autodiff();
    let (classes, count) = (inputs.scene.classes.len(), views.len());
    let mut score = |identities: &Identities| Ok(held_out.score(identities, inputs).miou);
    let mut fit = |model: &mut dyn Model, rate: f64| -> Result<RowOutcome> {
        let curve = train(model, views, &plan, &pace, &mut score, progress)?;
        let identities = model.identities()?;
        Ok(RowOutcome {
            scores: held_out.score(&identities, inputs),
            identities: Some(identities),
            learnable_bytes: model.learnable_bytes(),
            rate: Some(rate),
            seconds: curve.last().map_or(0.0, |p| p.seconds),
            curve,
            ..untrained(row)
        })
    };
    if !row.is_fused() {
        let rate = config.lr_per_gaussian;
        return fit(&mut PerGaussian::new(inputs.gaussians.len(), classes, rate, &device), rate);
    }
    let source = spatial.source(row, inputs)?;
    fit(&mut decoder_row(row, source, inputs, count), config.lr)
}

/// The decoder of `row` before its first step, over the frozen inputs `source`, for `views` training views.
pub fn decoder_row<'a>(row: Row, source: &'a Source, inputs: &'a Inputs, views: usize) -> Fused<'a> {
    let config = &inputs.config.segmentation;
    let (seed, classes) = (inputs.config.seed, inputs.scene.classes.len());
    let plan = FusedPlan {
        config,
        rate: config.lr,
        regularised: row != Row::OursCe && config.lambda_reg > 0.0,
        size: [inputs.gaussians.len(), classes],
        seed,
    };
    let device = inputs.device.clone().autodiff();
    let pyramid = &source.scene().pyramid;
    let decoder = DecoderConfig::for_pyramid(pyramid, classes, pyramid.levels.len() > 1)
        .with_layer_norm(config.layer_norm)
        .with_seed(seed)
        .init(&device);
    Fused::new(decoder, source, &inputs.gaussians.means, views, plan, &device)
}
