//! A run of both stages into a run folder.

use super::{
    CAMERAS, CONFIG, FEATURE_COLORS, IDENTITIES, RENDERS, RunFolder, SCENE, VIEWER, scene_path,
};
use crate::config::Config;
use crate::data::formats::transforms;
use crate::data::{self, LoadOptions, Split};
use crate::error::{Error, Result, ensure};
use crate::files::{absolute, atomic, sha256};
use crate::pipeline::{self, Outcome};
use crate::progress::Progress;
use crate::ranks;
use crate::report::{Command, Metrics, Report, held_out_views};
use crate::splat::ply;
use crate::viewer::{MAX_PAGE_BYTES, Viewer};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a run is asked for.
#[derive(Clone, Debug, Default)]
pub struct RunOptions {
    /// The scene folder. Without one a new run trains the built-in room, and a resumed one its own scene.
    pub data: Option<PathBuf>,
    /// A scene whose Gaussians are labelled instead of new ones, see [`scene_path`].
    pub scene: Option<PathBuf>,
    /// The run folder, see [`RunFolder::new`].
    pub out: Option<PathBuf>,
    /// A run to continue. It has its own scene, folder, settings file and seed.
    pub resume: Option<PathBuf>,
    /// The settings file.
    pub config: Option<PathBuf>,
    /// Settings as for [`Config::load`].
    pub sets: Vec<String>,
    /// The seed, where not that of the settings.
    pub seed: Option<u64>,
}

impl RunOptions {
    /// The run folder and the settings, with absolute paths: a run is resumed and scored from other folders too.
    ///
    /// # Errors
    /// As [`Config::load_for`], [`RunFolder::new`] and [`RunFolder::existing`], and [`scene_path`].
    pub fn open(&self) -> Result<(RunFolder, Config)> {
        let mut sets = Vec::new();
        if let Some(scene) = &self.scene {
            // Ahead of the others.
            sets.extend(settings_of_scene(scene)?);
        }
        sets.extend_from_slice(&self.sets);
        if let Some(dir) = &self.resume {
            let run = RunFolder::existing(dir)?;
            let config = run.config_for(self.data.as_deref(), &sets)?;
            return Ok((run, config.with_absolute_paths()?));
        }
        let mut config = Config::load_for(self.data.as_deref(), self.config.as_deref(), &sets)?;
        if let (Some(scene), None) = (&self.scene, &config.data.dir) {
            expect_built_in(scene)?;
        }
        config.seed = self.seed.unwrap_or(config.seed);
        if ranks::count() > 1 {
            config.building.batch.get_or_insert(ranks::count());
            config.segmentation.batch.get_or_insert(ranks::count());
        }
        config.validate()?;
        let run = RunFolder::new(self.out.as_deref(), &scene_name(&config))?;
        Ok((run, config.with_absolute_paths()?))
    }
}

/// Refuses `scene`, which comes without a scene folder, unless a run on the built-in room wrote it.
fn expect_built_in(scene: &Path) -> Result<()> {
    let file = scene_path(scene)?.with_file_name(CONFIG);
    let config = Config::load(Some(&file), &[]);
    ensure!(config.is_ok_and(|config| config.data.dir.is_none()),
        argument "--scene"; found "Gaussians without a scene folder";
        expected "the photos that they show and their label maps"; help "add --data DIR");
    Ok(())
}

/// Settings by which a run labels all Gaussians of `scene` and builds none.
fn settings_of_scene(scene: &Path) -> Result<[String; 4]> {
    // All Gaussians of the file come back.
    Ok([
        "building.iterations=0".to_owned(),
        "building.max_gaussians=unlimited".to_owned(),
        "unprojection.attendance=0".to_owned(),
        format!("building.gaussians={}", scene_path(scene)?.display()),
    ])
}

/// Refuses a scene folder that is not there, and a run folder that would mix with it.
///
/// # Errors
/// As [`data::locate`] and [`data::check_outputs`].
pub fn check_folder(run: &RunFolder, config: &Config) -> Result<()> {
    let Some(dir) = &config.data.dir else {
        return Ok(());
    };
    let options = LoadOptions::from(config);
    data::locate(dir, &options)?;
    let renders = run.file(RENDERS);
    data::check_outputs("--out", &[run.path(), &renders], Some((dir, &options)))
}

/// What [`train`] gives.
pub struct Trained {
    /// The results.
    pub outcome: Outcome,
    /// Size of the page for the browser. It was left out where this exceeds [`MAX_PAGE_BYTES`].
    pub page_bytes: usize,
}

/// Trains or resumes in the folder `run`, which [`RunFolder::claim`] locked, and writes its files. `command` is what the report
/// shows. Other [ranks] call [`follow`].
///
/// # Errors
/// Those of [`pipeline::run`] and of writing. A new run whose training has not begun is removed. A run that was stopped has its
/// checkpoints and its command.
pub fn train(
    run: &RunFolder,
    config: &Config,
    command: Command,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Trained> {
    let started = run.start(config, command)?;
    let outcome =
        Job::share(run, config).and_then(|()| pipeline::run(config, run.path(), device, progress));
    match &outcome {
        Ok(_) | Err(Error::Stopped) => {
            started.write_commands()?;
            ranks::finish();
        }
        Err(_) => started.remove_new(),
    }
    let outcome = outcome?;
    let page_bytes = write_scene(&outcome, run)?;
    write_report(&outcome, run, started.commands, device)?;
    Ok(Trained {
        outcome,
        page_bytes,
    })
}

/// A run that several [ranks] train.
#[derive(Serialize, Deserialize)]
struct Job {
    run: PathBuf,
    config: Config,
}

impl Job {
    /// Tells the other ranks of the job of this one.
    fn share(run: &RunFolder, config: &Config) -> Result<()> {
        let job = Self {
            run: absolute(run.path())?,
            config: config.clone(),
        };
        ranks::of_first(Some(job)).map(|_| ())
    }
}

/// Trains the run that rank 0 trains by [`train`], as one of the other [ranks]. It reads the scene and the checkpoints by the same
/// paths, and writes nothing.
///
/// # Errors
/// Those of [`pipeline::run`].
pub fn follow(device: &Device, progress: &mut dyn Progress) -> Result<()> {
    let Job { run, config } = ranks::of_first(None)?;
    let outcome = pipeline::run(&config, &run, device, progress);
    if matches!(outcome, Ok(_) | Err(Error::Stopped)) {
        ranks::finish();
    }
    outcome.map(|_| ())
}

/// Writes the labelled scene, its cameras and its page for the browser. Returns the size of that page, see [`Trained::page_bytes`].
fn write_scene(outcome: &Outcome, run: &RunFolder) -> Result<usize> {
    let scene = &outcome.scene;
    let gaussians = &outcome.gaussians;
    let identities = outcome.stored().map(|(_, identities)| identities);
    let ids = identities.map(|identities| identities.ids(&scene.classes));
    ply::write(&run.file(SCENE), gaussians, scene.origin, ids.as_deref())?;
    match identities {
        Some(identities) => identities.write(&run.file(IDENTITIES))?,
        // An earlier result, with other variants, may have left identities.
        None => atomic::remove(run.file(IDENTITIES))?,
    }
    let features = outcome.feature_colors.as_ref();
    match features {
        Some(colors) => colors.write(&run.file(FEATURE_COLORS))?,
        None => atomic::remove(run.file(FEATURE_COLORS))?,
    }
    let cameras = scene.cameras();
    transforms::write_cameras(&run.file(CAMERAS), &cameras)?;
    // Whoever opens the page may give a scene its first labels.
    let labels = ids.unwrap_or_else(|| scene.classes.unlabelled(gaussians.len()));
    let page_bytes = Viewer::bytes(gaussians, true);
    if page_bytes > MAX_PAGE_BYTES {
        // An earlier result may have left its page.
        atomic::remove(run.file(VIEWER))?;
        return Ok(page_bytes);
    }
    let viewer = Viewer {
        title: &scene_name(&outcome.config),
        scene: &run.path().display().to_string(),
        names: None,
        sha256: &sha256(&run.file(SCENE))?,
        gaussians,
        origin: scene.origin,
        labels: Some(&labels),
        features: features.map_or(&[], |colors| &colors.rgb),
        classes: &scene.classes,
        cameras: &cameras,
        up: scene.known_up(),
        alpha_max: outcome.config.raster.alpha_max,
    };
    viewer.write(&run.file(VIEWER))?;
    Ok(page_bytes)
}

/// Renders the held-out views, and writes the report and the metrics.
fn write_report(
    outcome: &Outcome,
    run: &RunFolder,
    commands: Vec<Command>,
    device: &Device,
) -> Result<()> {
    let classes = &outcome.scene.classes;
    let renders = run.file(RENDERS);
    let mut metrics = Metrics {
        commands,
        ..Metrics::of(outcome)
    };
    let mut scores = BTreeMap::new();
    let views = held_out_views(outcome, device, |view| {
        scores.insert(view.view.name.clone(), view.scores);
        view.write(classes, &renders)
    })?;
    let shown = views.iter().map(|v| (v.view.name.clone(), v.scores));
    scores.extend(shown);
    metrics.test.views = scores;
    // For a resumed run, the peak of all parts that ended regularly.
    metrics.peak_memory_bytes = metrics.peak_memory_bytes.max(run.peak_memory_before());
    let report = Report {
        metrics,
        classes,
        config: &outcome.config,
        held_out: outcome.scene.split(Split::Test).count(),
        views,
        notes: Report::notes_of(outcome),
    };
    report.write(run.path())
}

/// Name of the scene that `config` names, for the run folder.
pub fn scene_name(config: &Config) -> String {
    let dir = config.data.dir.as_deref();
    dir.map_or("builtin".to_owned(), data::scene_name)
}
