//! Times and peak memory of the stages of a run.

use super::machine::reset_peak_memory;
use super::{Bench, Figures};
use crate::config::{Budget, Variant};
use crate::error::{Error, Result};
use crate::metrics::ImageScores;
use crate::pipeline::SegmentationInputs;
use crate::pipeline::lift::lift;
use crate::pipeline::variants::train_variants;
use crate::progress::{Event, Progress};
use crate::reconstruction::{Trainer, TrainerState};
use crate::report::peak_memory_bytes;
use crate::splat::Gaussians;
use std::time::Instant;

/// Length of the run whose middle is measured, steps of stage one.
const RUN_STEPS: usize = 7_000;
/// Steps of either stage that are measured, for each repetition.
const STEPS: usize = 20;

pub(super) fn measure(bench: &Bench, gaussians: &Gaussians) -> Result<Figures> {
    let mut figures = Figures::new("stages", gaussians.len());
    let camera = &bench.scene.views[0].camera;
    figures.notes.push(format!(
        "{} training views of {}x{}; steps of stage one are from the middle of a run of {RUN_STEPS}",
        bench.scene.views.len(),
        camera.width,
        camera.height
    ));
    reset_peak_memory();
    stage_one(bench, gaussians, &mut figures)?;
    add_peak_memory("stage one", &mut figures);
    let labelled = bench.scene.labelled().count();
    if labelled == 0 || bench.scene.classes.is_empty() {
        let note = "the scene has no raw labels: stage two is left out";
        figures.notes.push(note.to_owned());
        return Ok(figures);
    }
    reset_peak_memory();
    stage_two(bench, gaussians, labelled, &mut figures)?;
    add_peak_memory("stage two", &mut figures);
    Ok(figures)
}

/// A step with everything in it: rendering, loss, backward pass, Adam, densification.
fn stage_one(bench: &Bench, gaussians: &Gaussians, figures: &mut Figures) -> Result<()> {
    let steps = STEPS * bench.repeats;
    let mut config = bench.config.clone();
    config.building.sh_degree = gaussians.sh_degree;
    config.building.iterations = RUN_STEPS;
    config.building.max_gaussians = Budget::AtMost(gaussians.len());
    // The last SH degree becomes active three eighths into the run.
    let every = config.building.densify_every.max(1);
    let densified = (3 * RUN_STEPS / 8 / every + 2) * every;
    let state = TrainerState {
        iteration: densified.saturating_sub(steps / 2 + steps),
        ..TrainerState::new(gaussians.clone(), config.seed)
    };
    let mut trainer = Trainer::from_state(&bench.scene, &config, &bench.device, state)?;
    for _ in 0..steps {
        trainer.step()?;
    }
    let mut plain = Vec::new();
    let mut densifying = Vec::new();
    for _ in 0..steps {
        let start = Instant::now();
        let of_kind = match trainer.step()?.densified {
            Some(_) => &mut densifying,
            None => &mut plain,
        };
        of_kind.push(1e3 * start.elapsed().as_secs_f64());
    }
    figures.add("stage one, a step", "ms", &plain);
    let name = format!("one step of {every}, with densification");
    figures.add(name, "ms", &densifying);
    Ok(())
}

/// Lifting of image features from all views, and steps of the decoder.
fn stage_two(
    bench: &Bench,
    gaussians: &Gaussians,
    labelled: usize,
    figures: &mut Figures,
) -> Result<()> {
    let mut config = bench.config.clone();
    let steps = labelled + STEPS * bench.repeats;
    config.segmentation.rows = Some(vec![Variant::Ours]);
    config.segmentation.iterations = steps;
    config.segmentation.fine_tune = Some(false);
    config.segmentation.eval_every = steps;
    config.segmentation.checkpoint_every = steps;
    config.unprojection.attendance = 0.0;
    let mut clock = Clock {
        last: Instant::now(),
        steps: Vec::new(),
    };
    let scores = ImageScores::default();
    let scene = &bench.scene;
    let device = &bench.device;
    let lifted = lift(gaussians, scene, scores, &config, device, &mut clock)?;
    let [features, unprojection] = lifted.seconds;
    let inputs = SegmentationInputs {
        lifted: lifted.features,
        ..SegmentationInputs::new(scene, &lifted.gaussians, &config, device)
    };
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), "create", e))?;
    train_variants(&inputs, folder.path(), &mut clock)?;
    figures.add("image features of all views", "s", &[features]);
    figures.add("their lifting onto the Gaussians", "s", &[unprojection]);
    // The first step on a view finds its labelled pixels, the Gaussians that they show, and the labels that replace raw ones.
    let (first, rest) = clock.steps.split_at(labelled.min(clock.steps.len()));
    figures.add("stage two, the first step on a view", "ms", first);
    figures.add("stage two, a step", "ms", rest);
    Ok(())
}

fn add_peak_memory(stage: &str, figures: &mut Figures) {
    if let Some(bytes) = peak_memory_bytes() {
        let name = format!("{stage}, peak memory of the process");
        figures.add(name, "MB", &[bytes as f64 / 1e6]);
    }
}

/// Milliseconds between the steps of training.
struct Clock {
    last: Instant,
    steps: Vec<f64>,
}

impl Progress for Clock {
    fn event(&mut self, event: &Event) {
        let now = Instant::now();
        if let Event::Step { .. } = event {
            self.steps.push(1e3 * (now - self.last).as_secs_f64());
        }
        self.last = now;
    }
}
