//! Training of one variant from start to end: curve, held-out scores, checkpoints, resuming.

use super::{ClassRecall, IdentityModel, Plan, TrainingViews, train_step};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::progress::{CurvePoint, Event, Progress};
use crate::provenance::Provenance;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// When a variant is evaluated and saved, and where.
#[derive(Clone, Debug)]
pub struct Schedule {
    /// Name of the variant, for progress.
    pub variant: &'static str,
    /// Iterations between held-out evaluations.
    pub eval_every: usize,
    /// Iterations between checkpoints.
    pub checkpoint_every: usize,
    /// The checkpoint; none is written or read where it is absent.
    pub checkpoint: Option<PathBuf>,
    /// Settings and data of the training; a checkpoint of any other is refused.
    pub provenance: Provenance,
}

/// Scores a model on the held-out views after the given number of iterations: the pooled mIoU, or none without such views.
pub type Evaluate<'a> = &'a mut dyn FnMut(&mut dyn IdentityModel, usize) -> Result<Option<f64>>;

/// The outcome of [`train_decoder`], beside the trained model.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingRun {
    /// One point for each evaluation.
    pub curve: Vec<CurvePoint>,
    /// Seconds of training before the checkpoint that was resumed.
    pub earlier_seconds: f64,
    /// Whether training reached the end of the plan; otherwise it was stopped.
    pub finished: bool,
}

/// What a checkpoint holds besides the model.
#[derive(Clone, Debug)]
struct State {
    iteration: usize,
    curve: Vec<CurvePoint>,
    /// Seconds so far; sum and number of the losses since the last point of the curve.
    running: [f64; 3],
    recall: ClassRecall,
}

/// Trains `model` by `plan` from its checkpoint, or from the start without one, to the end or until `progress` stops it.
///
/// # Errors
/// Those of [`train_step`]; the last checkpoint stays as it was. Those of reading or writing the checkpoint;
/// [`crate::Error::Config`] and [`crate::Error::Input`] when it was made from other settings or data.
pub fn train_decoder(
    model: &mut dyn IdentityModel,
    views: &mut TrainingViews,
    plan: &Plan,
    schedule: &Schedule,
    evaluate: Evaluate,
    progress: &mut dyn Progress,
) -> Result<TrainingRun> {
    let mut state = match &schedule.checkpoint {
        Some(path) if path.is_file() => restore(
            model,
            views.classes(),
            &schedule.provenance,
            plan.iterations,
            path,
        )?,
        _ => State {
            iteration: 0,
            curve: Vec::new(),
            running: [0.0; 3],
            recall: ClassRecall::new(views.classes()),
        },
    };
    let earlier_seconds = state.running[0];
    let gaussians = views.gaussians();
    progress.event(&Event::Started {
        stage: schedule.variant,
        done: state.iteration,
        iterations: plan.iterations,
    });
    while state.iteration < plan.iterations {
        let clock = Instant::now();
        let loss = f64::from(train_step(
            model,
            views,
            plan,
            &mut state.recall,
            state.iteration,
        )?);
        state.iteration += 1;
        let iteration = state.iteration;
        state.running[0] += clock.elapsed().as_secs_f64();
        state.running[1] += loss;
        state.running[2] += 1.0;
        progress.event(&Event::Step {
            iteration,
            loss,
            gaussians,
        });
        let stop = progress.stop();
        let end = iteration == plan.iterations;
        // No point for a stop: the curve of a resumed run is that of an uninterrupted one.
        if end || iteration.is_multiple_of(schedule.eval_every.max(1)) {
            let [seconds, sum, count] = state.running;
            let miou = evaluate(model, iteration)?;
            let point = CurvePoint {
                iteration,
                seconds,
                loss: sum / count.max(1.0),
                miou,
                gaussians,
                ..CurvePoint::default()
            };
            state.running = [seconds, 0.0, 0.0];
            state.curve.push(point);
            progress.event(&Event::Evaluated(point));
        }
        if let Some(path) = &schedule.checkpoint
            && (end || stop || iteration.is_multiple_of(schedule.checkpoint_every.max(1)))
        {
            save(model, &schedule.provenance, path, &state)?;
            progress.event(&Event::Saved { iteration });
        }
        if stop {
            break;
        }
    }
    let finished = state.iteration >= plan.iterations;
    if finished {
        progress.event(&Event::Finished);
    }
    Ok(TrainingRun {
        curve: state.curve,
        earlier_seconds,
        finished,
    })
}

const KIND: &str = "segmentation row";

fn save(
    model: &dyn IdentityModel,
    provenance: &Provenance,
    path: &Path,
    state: &State,
) -> Result<()> {
    let mut checkpoint = Checkpoint::new(KIND);
    checkpoint.set("iteration", &state.iteration)?;
    checkpoint.set("provenance", provenance)?;
    checkpoint.put_curve(&state.curve)?;
    checkpoint.put("running", &[3], state.running.to_vec())?;
    checkpoint.put("recall", &[state.recall.0.len()], state.recall.0.clone())?;
    let state = model.state();
    checkpoint.set(
        "tensors",
        &state
            .iter()
            .map(|(name, v)| (name.clone(), v.len()))
            .collect::<Vec<_>>(),
    )?;
    for (name, values) in state {
        checkpoint.put(name, &[values.len()], values)?;
    }
    checkpoint.save(path)
}

fn restore(
    model: &mut dyn IdentityModel,
    classes: usize,
    provenance: &Provenance,
    iterations: usize,
    path: &Path,
) -> Result<State> {
    let mut checkpoint = Checkpoint::load(path, KIND)?;
    let (stored, iteration): (Provenance, usize) =
        (checkpoint.get("provenance")?, checkpoint.get("iteration")?);
    provenance.check(&stored, iteration == iterations, path)?;
    let tensors: Vec<(String, usize)> = checkpoint.get("tensors")?;
    let mut state = std::collections::HashMap::new();
    for (name, length) in tensors {
        let values: Vec<f32> = checkpoint.take(&name, &[length])?;
        state.insert(name, values);
    }
    if model.restore(&|name| state.get(name).cloned()).is_none() {
        return Err(checkpoint.wrong(
            "tensors",
            "those of another model",
            "parameters and moments of this row",
        ));
    }
    let running: Vec<f64> = checkpoint.take("running", &[3])?;
    let running = [running[0], running[1], running[2]];
    let recall = ClassRecall(checkpoint.take("recall", &[classes])?);
    let mut curve = checkpoint.take_curve()?;
    if !provenance.renders_as(&stored) {
        // Scores by another rule than this run's.
        curve.iter_mut().for_each(|point| point.miou = None);
    }
    Ok(State {
        iteration,
        curve,
        running,
        recall,
    })
}
