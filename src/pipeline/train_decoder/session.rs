//! Training of one row from start to end: curve, held-out scores, checkpoints, resuming.

use super::{Model, Plan, Recalls, TrainingViews, train_step};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::progress::{CurvePoint, Event, Progress};
use crate::provenance::Provenance;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// When a row is measured and saved, and where.
#[derive(Clone, Debug)]
pub struct Pace {
    /// Name of the row, for progress.
    pub row: &'static str,
    /// Iterations between held-out evaluations.
    pub eval_every: usize,
    /// Iterations between checkpoints.
    pub checkpoint_every: usize,
    /// The checkpoint; absent means none is written or read.
    pub checkpoint: Option<PathBuf>,
    /// What the row is trained from; a checkpoint of anything else is refused.
    pub provenance: Provenance,
}

/// Scores the identities of a model on the held-out views after so many iterations: pooled mIoU, none where nothing can be scored.
pub type Score<'a> = &'a mut dyn FnMut(&mut dyn Model, usize) -> Result<Option<f64>>;

/// What training gave beside the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// One point an evaluation.
    pub curve: Vec<CurvePoint>,
    /// Seconds of training that the checkpoint had.
    pub earlier: f64,
    /// Whether the model is trained to the end of the plan; otherwise it was stopped.
    pub whole: bool,
}

/// What a checkpoint holds besides the model.
#[derive(Clone, Debug)]
struct Place {
    iteration: usize,
    curve: Vec<CurvePoint>,
    /// Seconds so far; sum and number of the losses since the last point of the curve.
    running: [f64; 3],
    recalls: Recalls,
}

/// Trains `model` by `plan` from its checkpoint, or from the start when there is none, to the end or until `progress` says stop.
///
/// # Errors
/// Those of [`train_step`]; the last checkpoint stays as it was. Those of reading or writing the checkpoint;
/// [`crate::Error::Config`] and [`crate::Error::Input`] when it was made from other settings or data.
pub fn train(
    model: &mut dyn Model,
    views: &mut TrainingViews,
    plan: &Plan,
    pace: &Pace,
    score: Score,
    progress: &mut dyn Progress,
) -> Result<Session> {
    let mut place = match &pace.checkpoint {
        Some(path) if path.is_file() => restore(
            model,
            views.classes(),
            &pace.provenance,
            plan.iterations,
            path,
        )?,
        _ => Place {
            iteration: 0,
            curve: Vec::new(),
            running: [0.0; 3],
            recalls: Recalls::new(views.classes()),
        },
    };
    let earlier = place.running[0];
    let gaussians = views.gaussians();
    progress.event(&Event::Started {
        stage: pace.row,
        done: place.iteration,
        iterations: plan.iterations,
    });
    while place.iteration < plan.iterations {
        let clock = Instant::now();
        let loss = f64::from(train_step(
            model,
            views,
            plan,
            &mut place.recalls,
            place.iteration,
        )?);
        place.iteration += 1;
        let iteration = place.iteration;
        place.running[0] += clock.elapsed().as_secs_f64();
        place.running[1] += loss;
        place.running[2] += 1.0;
        progress.event(&Event::Step {
            iteration,
            loss,
            gaussians,
        });
        let stop = progress.stop();
        let end = iteration == plan.iterations;
        // No point for a stop: the curve of a resumed run is that of an uninterrupted one.
        if end || iteration.is_multiple_of(pace.eval_every.max(1)) {
            let [seconds, sum, count] = place.running;
            let miou = score(model, iteration)?;
            let point = CurvePoint {
                iteration,
                seconds,
                loss: sum / count.max(1.0),
                miou,
                gaussians,
                ..CurvePoint::default()
            };
            place.running = [seconds, 0.0, 0.0];
            place.curve.push(point);
            progress.event(&Event::Evaluated(point));
        }
        if let Some(path) = &pace.checkpoint
            && (end || stop || iteration.is_multiple_of(pace.checkpoint_every.max(1)))
        {
            save(model, &pace.provenance, path, &place)?;
            progress.event(&Event::Saved { iteration });
        }
        if stop {
            break;
        }
    }
    let whole = place.iteration >= plan.iterations;
    if whole {
        progress.event(&Event::Finished);
    }
    Ok(Session {
        curve: place.curve,
        earlier,
        whole,
    })
}

const KIND: &str = "segmentation row";

fn save(model: &dyn Model, provenance: &Provenance, path: &Path, place: &Place) -> Result<()> {
    let mut checkpoint = Checkpoint::new(KIND);
    checkpoint.set("iteration", &place.iteration)?;
    checkpoint.set("provenance", provenance)?;
    checkpoint.put_curve(&place.curve)?;
    checkpoint.put("running", &[3], place.running.to_vec())?;
    checkpoint.put("recalls", &[place.recalls.0.len()], place.recalls.0.clone())?;
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
    model: &mut dyn Model,
    classes: usize,
    provenance: &Provenance,
    iterations: usize,
    path: &Path,
) -> Result<Place> {
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
    // Earlier versions had none.
    let recalls = match checkpoint.shape("recalls") {
        Ok(_) => Recalls(checkpoint.take("recalls", &[classes])?),
        Err(_) => Recalls::new(classes),
    };
    let mut curve = checkpoint.take_curve()?;
    if !provenance.renders_as(&stored) {
        // Scores by another rule than this run's.
        curve.iter_mut().for_each(|point| point.miou = None);
    }
    Ok(Place {
        iteration,
        curve,
        running,
        recalls,
    })
}
