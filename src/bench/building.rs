//! A step of stage one with everything in it: rendering, loss, backward pass, Adam, densification.

use super::{Bench, Findings, Samples};
use crate::data::Split;
use crate::error::Result;
use crate::reconstruction::{Trainer, TrainerState};
use crate::splat::Gaussians;

/// Length of the run whose middle is measured, steps.
const RUN: usize = 7_000;

pub(super) fn measure(
    bench: &Bench,
    gaussians: &Gaussians,
    case: &str,
    findings: &mut Findings,
) -> Result<()> {
    let Some(scene) = &bench.subject.scene else {
        let why = "--scene and --cameras have no photos; use --run or --data";
        findings.skipped = Some(why.to_owned());
        return Ok(());
    };
    let effort = &bench.effort;
    let steps = effort.steps * effort.repeats.max(1);
    if let Some(view) = scene.split(Split::Train).next() {
        let (width, height) = (view.camera.width, view.camera.height);
        findings.note(format!(
            "photos of {width}x{height}; {steps} steps from the middle of a run of {RUN}, one with densification"
        ));
    }
    let mut config = bench.config.clone();
    config.building.sh_degree = gaussians.sh_degree;
    config.building.iterations = RUN;
    config.building.max_gaussians = gaussians.len();
    // Three eighths into the run the last SH degree comes on.
    let every = config.building.densify_every.max(1);
    let densified = (3 * RUN / 8 / every + 2) * every;
    let state = TrainerState {
        iteration: densified.saturating_sub(steps / 2 + effort.settle),
        ..TrainerState::new(gaussians.clone(), config.seed)
    };
    let mut stage = Trainer::from_state(scene, &config, &bench.device, state)?;
    for _ in 0..effort.settle {
        stage.step()?;
    }
    let mut all = Samples::default();
    let mut densifying = Samples::default();
    for _ in 0..steps {
        let mut one = Samples::default();
        let report = one.time(|| stage.step())?;
        all.push(one.sum());
        if report.densified.is_some() {
            densifying.push(one.sum());
        }
    }
    findings.measured(case, "a step", "ms", &all.scaled(1e3));
    if !densifying.is_empty() {
        let name = format!("one step of {every}, with densification");
        findings.measured(case, &name, "ms", &densifying.scaled(1e3));
    }
    let mean = 1e3 * all.sum() / all.len().max(1) as f64;
    findings.counted(case, "mean of all steps", "ms", mean);
    Ok(())
}
