//! Learning rates chosen without test truth: short trials, scored on raw labels of training views that were held back.

use super::checkpoint::Checkpoint;
use super::progress::{Event, Progress};
use super::segmentation::{Model, Plan, Recalls, TrainingViews, train_step};
use super::segmentation_inputs::Inputs;
use crate::data::LabelRuns;
use crate::error::Result;
use crate::metrics::{Void, label_scores};
use crate::objects::{Identities, LabelRule, label_map};
use crate::raster::Projected;
use std::path::Path;
use std::time::Instant;

/// Every so many training views one is held back in a trial.
pub const HELD_BACK: usize = 8;
/// A trial runs for this share of the row's iterations.
const TRIAL_SHARE: f64 = 0.25;
const KIND: &str = "learning rate";

/// A learning rate, and the seconds that it took to choose where there was a choice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// The rate.
    pub rate: f64,
    /// Seconds of all trials.
    pub seconds: Option<f64>,
    /// Those of them that an earlier part of a resumed run took: all or none.
    pub earlier: f64,
}

/// Makes an untrained model that learns at a rate, for the views in use.
pub type Fresh<'m, 'a> = &'m mut dyn FnMut(f64, &TrainingViews) -> Result<Box<dyn Model + 'a>>;

/// The rate that does best of `base` times `segmentation.lr_trials`: a fresh `model` is trained for each, a quarter as
/// long as the row will be, without every eighth training view; it is scored by its accuracy on the raw labels of those.
///
/// The choice is kept at `path`, where a resumed run finds it. None where `progress` said stop before there was one.
///
/// # Errors
/// Those of training and of the file.
pub fn choose_rate<'a>(
    base: f64,
    plan: &Plan,
    views: &mut TrainingViews,
    inputs: &Inputs,
    path: &Path,
    model: Fresh<'_, 'a>,
    progress: &mut dyn Progress,
) -> Result<Option<Rate>> {
    let factors = &inputs.config.segmentation.lr_trials;
    if factors.len() < 2 || views.len() < 2 {
        let rate = base * factors.first().copied().unwrap_or(1.0);
        return Ok(Some(Rate { rate, seconds: None, earlier: 0.0 }));
    }
    if path.is_file() {
        let checkpoint = Checkpoint::load(path, KIND)?;
        let (of, from, rate): (Vec<f64>, f64, f64) = checkpoint.get("choice")?;
        if (&of, from) == (factors, base) {
            let seconds: Option<f64> = checkpoint.get("seconds").ok();
            return Ok(Some(Rate { rate, seconds, earlier: seconds.unwrap_or(0.0) }));
        }
    }
    let trial = Plan { iterations: ((plan.iterations as f64 * TRIAL_SHARE).ceil() as usize).max(1), ..plan.clone() };
    let trial = Plan { warmup: (plan.warmup as f64 * TRIAL_SHARE).round() as usize, ..trial };
    views.hold_back(Some(HELD_BACK.min(views.len())));
    let clock = Instant::now();
    let mut best = (f64::NEG_INFINITY, base);
    let gaussians = views.gaussians();
    progress.event(&Event::Started { stage: "rates", done: 0, iterations: factors.len() * trial.iterations });
    for (tried, factor) in factors.iter().enumerate() {
        let (mut model, mut recalls) = (model(base * factor, views)?, Recalls::new(views.classes()));
        for iteration in 0..trial.iterations {
            let loss = f64::from(train_step(model.as_mut(), views, &trial, &mut recalls, iteration)?);
            let iteration = tried * trial.iterations + iteration + 1;
            progress.event(&Event::Step { iteration, loss, gaussians });
            if progress.stop() {
                views.hold_back(None);
                return Ok(None);
            }
        }
        let score = raw_accuracy(&model.identities()?, views, inputs)?;
        if score > best.0 {
            best = (score, base * factor);
        }
    }
    views.hold_back(None);
    progress.event(&Event::Finished);
    let seconds = clock.elapsed().as_secs_f64();
    let mut checkpoint = Checkpoint::new(KIND);
    checkpoint.set("choice", &(factors, base, best.1))?;
    checkpoint.set("seconds", &seconds)?;
    checkpoint.save(path)?;
    Ok(Some(Rate { rate: best.1, seconds: Some(seconds), earlier: 0.0 }))
}

/// Share of the labelled pixels of the views held back on which rendered and raw label agree.
fn raw_accuracy(identities: &Identities, views: &TrainingViews, inputs: &Inputs) -> Result<f64> {
    let classes = &inputs.scene.classes;
    let rule = LabelRule::from(&inputs.config.segmentation);
    let splats = inputs.gaussians.splats();
    let mut maps = Vec::new();
    for view in views.held_back() {
        let projected = Projected::new(&splats, &view.camera, &inputs.settings)?;
        maps.push(LabelRuns::from(label_map(&projected, identities, classes, &rule)));
    }
    let raw = views.held_back().filter_map(|view| view.raw.as_ref());
    let pairs = raw.zip(&maps).map(|(raw, map)| (raw.map(), map.map()));
    Ok(label_scores(classes, pairs, Void::Wrong).accuracy.unwrap_or(0.0))
}
