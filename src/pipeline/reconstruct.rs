//! Stage one of a run: photos to Gaussians, from a checkpoint, from points, or from the Gaussians of another run.

use super::initial_scene::load_initial_scene;
use crate::checkpoint::Checkpoint;
use crate::config::Config;
use crate::data::Scene;
use crate::error::{Error, Result};
use crate::files::{self, atomic};
use crate::progress::{CurvePoint, Progress, Review};
use crate::provenance::Provenance;
use crate::ranks;
use crate::reconstruction::{Trainer, TrainerState};
use crate::splat::{Gaussians, ply};
use burn::tensor::Device;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Checkpoint of stage one.
const BUILDING: &str = "building.safetensors";
/// Provenance of Gaussians that were taken as they are.
const INITIAL: &str = "initial.safetensors";
/// Labels that a person corrected.
const CORRECTIONS: &str = "corrections.safetensors";
/// Kind of the second file.
const INITIAL_KIND: &str = "initial Gaussians";

/// Result of stage one.
#[derive(Default)]
pub(crate) struct Reconstruction {
    /// In spatial order.
    pub gaussians: Gaussians,
    /// Held-out scores over the iterations.
    pub curve: Vec<CurvePoint>,
    /// Reviews of the number of Gaussians.
    pub reviews: Vec<Review>,
    /// Seconds of stage one, earlier parts of a resumed run included.
    pub seconds: f64,
    /// The share of `seconds` that earlier parts took.
    pub earlier: f64,
    /// Whether the stage came to its end; otherwise `progress` stopped it.
    pub complete: bool,
    /// Optimiser steps of this part of the run.
    pub steps: usize,
    /// Whether this part of the run made the Gaussians.
    new: bool,
}

/// Files of a run.
pub(crate) struct RunFiles {
    /// Folder of checkpoints.
    pub checkpoints: PathBuf,
    /// The scene as PLY.
    pub scene: PathBuf,
}

impl RunFiles {
    /// The files of the run folder `out`.
    pub fn new(out: &Path) -> Self {
        Self {
            checkpoints: out.join("checkpoint"),
            scene: out.join("scene.ply"),
        }
    }

    /// Labels that a person corrected.
    pub fn corrections(&self) -> PathBuf {
        self.checkpoints.join(CORRECTIONS)
    }

    /// Removes the checkpoints of stage two.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn forget_stage_two(&self) -> Result<()> {
        let is_of_stage_two = |name: &str, _: &Path| {
            name.ends_with(".safetensors") && ![BUILDING, INITIAL, CORRECTIONS].contains(&name)
        };
        let names = files::names(&self.checkpoints, is_of_stage_two);
        let mut files = names.iter().map(|name| self.checkpoints.join(name));
        files.try_for_each(atomic::remove)
    }

    fn building(&self) -> PathBuf {
        self.checkpoints.join(BUILDING)
    }

    fn initial(&self) -> PathBuf {
        self.checkpoints.join(INITIAL)
    }
}

/// Gaussians from the photos of `scene`. Writes checkpoints and `scene.ply`.
///
/// # Errors
/// Those of the initial scene, of training, and of files; [`Error::Stopped`]; an unusable initial scene leaves no run folder behind.
pub(crate) fn reconstruct(
    scene: &Scene,
    config: &Config,
    files: &RunFiles,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Reconstruction> {
    let checkpoints = [files.building(), files.initial()].map(|file| file.is_file());
    ranks::expect_same("the checkpoints", format!("{checkpoints:?}"))?;
    let as_they_are = config.building.iterations == 0;
    let initial = match &config.building.gaussians {
        Some(path) if as_they_are || !files.building().is_file() => {
            let initial = load_initial_scene(path, scene, config, &files.scene, device)?;
            Some(initial)
        }
        _ => None,
    };
    let folder = &files.checkpoints;
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
    let clock = Instant::now();
    let mut result = match initial {
        Some(gaussians) if as_they_are => take(gaussians, scene, config, files)?,
        initial => build(scene, config, initial, files, device, progress)?,
    };
    // The scene of a finished run stays until there is another result.
    if ranks::index() == 0 && (result.new || !files.scene.exists()) {
        ply::write(&files.scene, &result.gaussians, scene.origin, None)?;
    }
    if !result.complete {
        return Err(Error::Stopped);
    }
    result.seconds = clock.elapsed().as_secs_f64() + result.earlier;
    Ok(result)
}

/// Takes `gaussians` as they are. A resumed run has to have begun with them, and with these photos.
fn take(
    gaussians: Gaussians,
    scene: &Scene,
    config: &Config,
    files: &RunFiles,
) -> Result<Reconstruction> {
    let built = files.building();
    let initial = files.initial();
    let provenance = Provenance::initial_scene(config, scene, &gaussians);
    if built.is_file() {
        let stored = TrainerState::load(&built)?.provenance;
        provenance.check(&stored, false, &built, None)?;
    }
    let new = !initial.is_file();
    if new && ranks::index() == 0 {
        let mut checkpoint = Checkpoint::new(INITIAL_KIND);
        checkpoint.set("provenance", &provenance)?;
        checkpoint.save(&initial)?;
    } else if !new {
        let stored = Checkpoint::load(&initial, INITIAL_KIND)?.get("provenance")?;
        provenance.check(&stored, false, &initial, None)?;
    }
    Ok(Reconstruction {
        gaussians: gaussians.select(&gaussians.spatial_order()),
        complete: true,
        new,
        ..Reconstruction::default()
    })
}

/// Trains Gaussians from the checkpoint, from the `initial` ones, or from points.
fn build(
    scene: &Scene,
    config: &Config,
    initial: Option<Gaussians>,
    files: &RunFiles,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Reconstruction> {
    let checkpoint = files.building();
    let taken = files.initial();
    if taken.is_file() {
        let stored = Checkpoint::load(&taken, INITIAL_KIND)?.get("provenance")?;
        Provenance::stage_one(config, scene).check(&stored, false, &taken, None)?;
    }
    let state = match initial {
        _ if checkpoint.is_file() => Some(TrainerState::load(&checkpoint)?),
        Some(gaussians) => {
            let gaussians = gaussians.with_sh_degree(config.building.sh_degree);
            Some(TrainerState::new(gaussians, config.seed))
        }
        None => None,
    };
    let stage = match state {
        Some(state) => Trainer::from_state(scene, config, device, state)?,
        None => Trainer::new(scene, config, device)?,
    };
    let mut stage = stage.checkpoint_at(checkpoint);
    let earlier = stage.seconds();
    let first = stage.iteration();
    stage.run(progress)?;
    let gaussians = stage.gaussians()?;
    Ok(Reconstruction {
        gaussians: gaussians.select(&gaussians.spatial_order()),
        curve: stage.curve().to_vec(),
        reviews: stage.reviews().to_vec(),
        seconds: 0.0,
        earlier,
        complete: stage.iteration() >= config.building.iterations,
        steps: (stage.iteration() - first).div_ceil(config.building.batch()),
        new: stage.iteration() > first,
    })
}
