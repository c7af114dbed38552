//! The report of a finished run.

use super::peak_memory_bytes;
use super::views::shown_of;
use super::{
    BuildingHistory, HeldOutView, History, Metrics, Report, Sample, TestScores, VariantHistory,
    VariantScores,
};
use crate::config::{Config, Variant};
use crate::data::{Split, View};
use crate::error::Result;
use crate::objects::{LabelMaps, has_truth};
use crate::pipeline::{Outcome, Pictures, Pruned, VariantOutcome};
use crate::progress::CurvePoint;
use burn::tensor::Device;

impl Metrics {
    /// The figures of a finished run without its commands and the scores of single views. Peak memory is that of this process
    /// so far.
    pub fn of(outcome: &Outcome) -> Self {
        let rows = outcome.rows.iter();
        Self {
            scene: outcome.scene.name.clone(),
            gaussians: outcome.gaussians.len(),
            association: outcome.association,
            test: TestScores {
                psnr: outcome.test.psnr,
                ssim: outcome.test.ssim,
                views: Default::default(),
                labels: rows.map(|row| (row.variant, variant_scores(row))).collect(),
            },
            seconds: outcome.seconds,
            ranks: outcome.traffic,
            peak_memory_bytes: peak_memory_bytes(),
            learnable_bytes: outcome.learnable_bytes().into_iter().collect(),
            spatial: outcome.spatial.clone(),
            features: outcome.features.clone(),
            commands: Vec::new(),
            curves: History::of(outcome),
        }
    }
}

fn variant_scores(row: &VariantOutcome) -> VariantScores {
    VariantScores {
        void_left_out: row.void_left_out.as_ref().map(|scores| scores.pixels),
        iterations: row.curve.last().map(|point| point.iteration),
        learning_rate: row.rate,
        fine_tuning_steps: row.fine_tuning_steps,
        seconds: row.curve.last().map(|_| row.seconds),
        ..VariantScores::from(&row.scores)
    }
}

/// One measurement of every point of a curve that has it.
fn samples(curve: &[CurvePoint], pick: impl Fn(&CurvePoint) -> Option<f64>) -> Vec<Sample> {
    curve
        .iter()
        .filter_map(|point| Some((point.iteration, pick(point)?)))
        .collect()
}

impl History {
    /// The curves of a finished run.
    pub fn of(outcome: &Outcome) -> Self {
        // A point at iteration 0 has no training loss yet.
        let loss = |curve: &[CurvePoint]| samples(curve, |p| (p.iteration > 0).then_some(p.loss));
        let b = &outcome.building;
        let rows = outcome.rows.iter().filter(|row| !row.curve.is_empty());
        Self {
            building: BuildingHistory {
                loss: loss(b),
                psnr: samples(b, |p| p.held_out.psnr),
                ssim: samples(b, |p| p.held_out.ssim),
                gaussians: samples(b, |p| Some(p.gaussians as f64)),
                reviews: outcome.reviews.clone(),
            },
            rows: rows
                .map(|r| VariantHistory {
                    variant: r.variant,
                    loss: loss(&r.curve),
                    miou: samples(&r.curve, |p| p.miou),
                })
                .collect(),
        }
    }
}

/// Renders the held-out views of a finished run on `device`: colour, and labels where the run has them. Labels are those of the
/// vote, of the per-Gaussian identities and of the variant that the scene stores. Returns the views that the page shows. Each other
/// view goes to `beside` as soon as it is rendered.
///
/// # Errors
/// As [`Pictures::labelled`]; those of `beside`.
pub fn held_out_views<'a>(
    outcome: &'a Outcome,
    device: &Device,
    mut beside: impl FnMut(HeldOutView<'a>) -> Result<()>,
) -> Result<Vec<HeldOutView<'a>>> {
    let stored = outcome.stored().map(|(row, _)| row.variant);
    let shown =
        |row: Variant| Some(row) == stored || matches!(row, Variant::Vote | Variant::PerGaussian);
    let is_shown = |row: &&VariantOutcome| shown(row.variant) && row.identities.is_some();
    let rows: Vec<_> = outcome.rows.iter().filter(is_shown).collect();
    let config = &outcome.config;
    let source = config.segmentation.render;
    let coverage = config.segmentation.min_coverage as f32;
    let classes = &outcome.scene.classes;
    let identities = rows.iter().filter_map(|r| r.identities.as_ref());
    let maps: Vec<_> = identities
        .map(|identities| LabelMaps::new(identities, classes, source, coverage))
        .collect();
    let pictures = Pictures::new(&outcome.gaussians, config, device)?;
    let test: Vec<&View> = outcome.scene.split(Split::Test).collect();
    let on_page: Vec<usize> = shown_of(test.len()).collect();
    let mut views = Vec::new();
    for (i, view) in test.into_iter().enumerate() {
        let (rgb, scores, labels) = pictures.labelled(view, &maps)?;
        let labels = rows.iter().map(|row| row.variant).zip(labels).collect();
        let rendered = HeldOutView {
            view,
            rgb,
            scores,
            labels,
        };
        if on_page.contains(&i) {
            views.push(rendered);
        } else {
            beside(rendered)?;
        }
    }
    Ok(views)
}

impl Report<'_> {
    /// Notes for a reader of the figures.
    pub fn notes_of(outcome: &Outcome) -> Vec<String> {
        let mut notes = notes_of_inputs(outcome, &outcome.config);
        notes.extend(notes_of_labels(outcome, &outcome.config));
        notes.extend(outcome.pruned.as_ref().map(note_of_pruning));
        notes
    }
}

/// Notes on the photos, and on the Gaussians that the run began with.
fn notes_of_inputs(outcome: &Outcome, config: &Config) -> Vec<String> {
    let mut notes = Vec::new();
    if config.data.dir.is_none() {
        notes.push("The scene is the built-in one: procedural and ray-cast.".to_owned());
    }
    if let Some(path) = &config.building.gaussians {
        let what = match config.building.iterations {
            0 => "are those of a file, without training",
            _ => "were trained from those of a file",
        };
        notes.push(format!("The Gaussians {what}: {}.", path.display()));
    }
    let scene = &outcome.scene;
    let association = config.data.association;
    let scored = |view: &View| has_truth(view, association, outcome.semantics.as_ref());
    if !scene.split(Split::Test).any(scored) && !outcome.rows.is_empty() {
        notes.push("No held-out view has true labels: no row of labels is scored.".to_owned());
    }
    let views = scene.views.len();
    let has_mask = |view: &&View| view.mask.is_some();
    let masked = scene.views.iter().filter(has_mask).count();
    if masked > 0 {
        notes.push(format!(
            "Masks leave pixels of {masked} of {views} photos out of training and of all scores."
        ));
    }
    notes
}

/// Notes on the labels that the rows were trained on, and on their losses.
fn notes_of_labels(outcome: &Outcome, config: &Config) -> Vec<String> {
    let mut notes = Vec::new();
    let rows = || outcome.rows.iter().map(|row| row.variant);
    if rows().any(|row| row == Variant::Raw) {
        notes.push("Raw labels of held-out views are scored, never trained on.".to_owned());
    }
    if rows().any(Variant::uses_configured_loss) {
        let s = &config.segmentation;
        let steps = (s.warmup * s.iterations as f64).round();
        notes.push(format!(
            "The rows called ours learn with segmentation.loss = {}, after {steps} steps of cross-entropy.",
            serde_json::json!(s.loss())
        ));
    }
    if let Some(counts) = &outcome.association {
        notes.push(format!(
            "The ids of the raw labels are valid only within a view. By association, {counts}."
        ));
    }
    if let Some(corrections) = &outcome.corrections
        && !outcome.rows.is_empty()
    {
        let count = corrections.count();
        notes.push(format!(
            "Gaussians whose label a person set: {count}. They keep it, and their pixels in training photos have it too."
        ));
    }
    notes
}

fn note_of_pruning(pruned: &Pruned) -> String {
    let psnr =
        |psnr: Option<f64>| psnr.map_or("not measured".to_owned(), |psnr| format!("{psnr:.2} dB"));
    format!(
        "Pruning of unseen Gaussians removed {} of {} Gaussians; held-out PSNR before {}, after {}.",
        pruned.before - pruned.after,
        pruned.before,
        psnr(pruned.scores_before.psnr),
        psnr(pruned.scores_after.psnr),
    )
}
