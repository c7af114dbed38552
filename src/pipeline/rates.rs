//! Learning rates chosen without test truth: short trials, scored on raw labels of training views that were held back.

use crate::error::Result;
use crate::metrics::{Void, label_scores};
use crate::objects::Identities;
use crate::pipeline::checkpoint::Checkpoint;
use crate::pipeline::held_out::LabelledViews;
use crate::pipeline::progress::{Event, Progress};
use crate::pipeline::segmentation_inputs::Inputs;
use crate::pipeline::train_decoder::{Model, Pace, Plan, Recalls, TrainingViews, train_step};
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

/// Makes an untrained model that learns at a rate by a plan, for the views in use.
pub type Fresh<'m, 'a> =
    &'m mut dyn FnMut(f64, &Plan, &mut TrainingViews) -> Result<Box<dyn Model + 'a>>;

/// The rate that does best of `base` times `segmentation.lr_trials`: a fresh `model` is trained for each, a quarter as
/// long as the row will be, without every eighth training view; it is scored by its accuracy on the raw labels of those.
///
/// The choice is kept beside the row's checkpoint, where a resumed run finds it. None where `progress` said stop before there
/// was one.
///
/// # Errors
/// Those of training and of the file; [`crate::Error::Config`] and [`crate::Error::Input`] when the file's choice was made with
/// other settings or data than `pace` says.
pub fn choose_rate<'a>(
    base: f64,
    plan: &Plan,
    views: &mut TrainingViews,
    inputs: &Inputs,
    pace: &Pace,
    model: Fresh<'_, 'a>,
    progress: &mut dyn Progress,
) -> Result<Option<Rate>> {
    let factors = &inputs.config.segmentation.lr_trials;
    if factors.len() < 2 || views.len() < 2 {
        let rate = base * factors.first().copied().unwrap_or(1.0);
        return Ok(Some(Rate {
            rate,
            seconds: None,
            earlier: 0.0,
        }));
    }
    let path = pace
        .checkpoint
        .as_ref()
        .map(|path| path.with_extension("rate.safetensors"));
    if let Some(path) = path.as_ref().filter(|path| path.is_file()) {
        let checkpoint = Checkpoint::load(path, KIND)?;
        let (of, from, rate): (Vec<f64>, f64, f64) = checkpoint.get("choice")?;
        // Earlier versions did not say what a choice was made from.
        if checkpoint.has("provenance") {
            pace.provenance
                .check(&checkpoint.get("provenance")?, false, path)?;
        }
        if (&of, from) == (factors, base) {
            let seconds: Option<f64> = checkpoint.get("seconds").ok();
            return Ok(Some(Rate {
                rate,
                seconds,
                earlier: seconds.unwrap_or(0.0),
            }));
        }
    }
    let trial = Plan {
        iterations: ((plan.iterations as f64 * TRIAL_SHARE).ceil() as usize).max(1),
        ..plan.clone()
    };
    let trial = Plan {
        warmup: (plan.warmup as f64 * TRIAL_SHARE).round() as usize,
        ..trial
    };
    views.hold_back(Some(HELD_BACK.min(views.len())));
    let clock = Instant::now();
    let mut best = (f64::NEG_INFINITY, base);
    let gaussians = views.gaussians();
    progress.event(&Event::Started {
        stage: "rates",
        done: 0,
        iterations: factors.len() * trial.iterations,
    });
    for (tried, factor) in factors.iter().enumerate() {
        let (mut model, mut recalls) = (
            model(base * factor, &trial, views)?,
            Recalls::new(views.classes()),
        );
        for iteration in 0..trial.iterations {
            let loss = f64::from(train_step(
                model.as_mut(),
                views,
                &trial,
                &mut recalls,
                iteration,
            )?);
            let iteration = tried * trial.iterations + iteration + 1;
            progress.event(&Event::Step {
                iteration,
                loss,
                gaussians,
            });
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
    if let Some(path) = path {
        let mut checkpoint = Checkpoint::new(KIND);
        checkpoint.set("choice", &(factors, base, best.1))?;
        checkpoint.set("seconds", &seconds)?;
        checkpoint.set("provenance", &pace.provenance)?;
        checkpoint.save(&path)?;
    }
    Ok(Some(Rate {
        rate: best.1,
        seconds: Some(seconds),
        earlier: 0.0,
    }))
}

/// Share of the labelled pixels of the views held back on which rendered and raw label agree.
fn raw_accuracy(identities: &Identities, views: &TrainingViews, inputs: &Inputs) -> Result<f64> {
    let classes = &inputs.scene.classes;
    let maps = LabelledViews::new(views.held_back(), inputs, 0)?.maps(identities, inputs)?;
    let pairs = maps
        .iter()
        .filter_map(|(view, map)| Some((view.raw.as_ref()?.map(), map.map())));
    Ok(label_scores(classes, pairs, Void::Wrong)
        .accuracy
        .unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::choose_rate;
    use crate::config::{Config, Variant};
    use crate::data::{Classes, LabelMap, Scene, Split, View};
    use crate::pipeline::progress::Silent;
    use crate::pipeline::train_decoder::{Model, Pace, PerGaussian, Plan, TrainingViews};
    use crate::pipeline::{Inputs, Provenance};
    use crate::raster::Settings;
    use crate::segmentation::loss::Kind;
    use crate::splat::Gaussians;
    use crate::splat::camera::Camera;
    use glam::{DMat3, DVec3};
    use image::RgbImage;

    /// A view of four pixels a side, of one class.
    fn view(name: &str) -> View {
        View {
            name: name.into(),
            split: Split::Train,
            camera: Camera {
                rotation: DMat3::IDENTITY,
                center: DVec3::ZERO,
                fx: 4.0,
                fy: 4.0,
                cx: 2.0,
                cy: 2.0,
                width: 4,
                height: 4,
            },
            image: RgbImage::new(4, 4).into(),
            mask: None,
            truth: None,
            raw: Some(
                LabelMap {
                    width: 4,
                    height: 4,
                    ids: vec![1; 16],
                }
                .into(),
            ),
            segments: Vec::new(),
            instances: None,
        }
    }

    #[test]
    fn models_are_made_for_the_plan_of_the_trial() {
        let scene = Scene {
            name: "two views".into(),
            views: vec![view("a"), view("b")],
            classes: Classes::from_names(0, [(1, "one"), (2, "two")]),
            points: Default::default(),
            origin: DVec3::ZERO,
            up: DVec3::Y,
        };
        let gaussians = Gaussians {
            means: vec![[0.0, 0.0, 2.0]],
            log_scales: vec![[0.0; 3]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]],
            opacity_logits: vec![3.0],
            sh: vec![0.0; 3],
            sh_degree: 0,
        };
        let mut config = Config::default();
        (
            config.segmentation.lr_trials,
            config.segmentation.iterations,
        ) = (vec![1.0, 2.0], 10);
        let device = crate::backend::device::open(
            crate::backend::device::BackendName::compiled()
                .last()
                .copied(),
        )
        .expect("a backend");
        let (scene, gaussians, settings) = (&scene, &gaussians, Settings::default());
        let inputs = Inputs {
            scene,
            gaussians,
            seen: None,
            semantics: None,
            config: &config,
            settings,
            device: &device,
        };
        let folder = tempfile::tempdir().expect("a folder");
        let pace = Pace {
            row: Variant::PerGaussian.key(),
            eval_every: 1,
            checkpoint_every: 1,
            checkpoint: Some(folder.path().join("per_gaussian.safetensors")),
            provenance: Provenance::default(),
        };
        let plan = Plan::new(&config.segmentation, Kind::Ce, 0);
        let mut views = inputs.training_views();
        let mut asked = Vec::new();
        let mut model = |rate: f64, plan: &Plan, _: &mut TrainingViews| {
            asked.push((rate, plan.iterations));
            let model = PerGaussian::new(
                [1, 2],
                rate,
                config.segmentation.blend,
                &device.clone().autodiff(),
            );
            Ok(Box::new(model) as Box<dyn Model>)
        };
        choose_rate(
            0.05,
            &plan,
            &mut views,
            &inputs,
            &pace,
            &mut model,
            &mut Silent,
        )
        .expect("a rate");
        assert_eq!(asked, [(0.05, 3), (0.1, 3)]);
        assert!(
            folder
                .path()
                .join("per_gaussian.rate.safetensors")
                .is_file()
        );
    }
}
