//! The main job: a scene in, a segmented Gaussian scene out, with everything that a report needs.

use super::given::begin;
use super::pictures::score_images;
use super::provenance::Provenance;
use super::pruned::{Attendance, Pruned};
use super::segmentation_inputs::Inputs;
use super::variants::{TrainedRows, VariantOutcome, run_rows};
use crate::checkpoint::Checkpoint;
use crate::config::{Association, Config, SegmentationConfig, Variant};
use crate::data::{self, LoadOptions, Scene, Split, View, builtin};
use crate::error::{Error, Result};
use crate::metrics::ImageScores;
use crate::objects::{self, Identities, Semantics, associate_until, has_truth};
use crate::progress::{CurvePoint, Progress, Viewing};
use crate::raster::Settings;
use crate::reconstruction::building::BuildingStage;
use crate::reconstruction::building_state::BuildingState;
use crate::splat::{Gaussians, ply};
use burn::tensor::Device;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

/// Seconds spent in each part of the job; evaluations are part of the stage they belong to. Training of earlier parts of a
/// resumed run counts; what such a run does again (loading, association, features, unprojection) counts once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// Stage one.
    pub building: f64,
    /// 2D feature extraction and reduction.
    pub features: f64,
    /// Lifting features onto Gaussians.
    pub unprojection: f64,
    /// Stage two, the point encoder included.
    pub segmentation: f64,
    /// Everything from loading to the last score.
    pub total: f64,
}

/// What association made of the raw labels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Associated {
    /// Segments of the training views.
    pub segments: usize,
    /// Objects that they show.
    pub objects: usize,
    /// Segments that belong to none.
    pub dropped: usize,
    /// Segments that were divided among several.
    pub divided: usize,
    /// Seconds that it took.
    pub seconds: f64,
}

/// All that a run made.
pub struct Outcome {
    /// The scene as loaded; after association its classes are objects and its raw labels say which.
    pub scene: Scene,
    /// The trained Gaussians in spatial order, after attendance pruning.
    pub gaussians: Gaussians,
    /// Curve of stage one.
    pub building: Vec<CurvePoint>,
    /// Mean held-out scores of the final Gaussians.
    pub test: ImageScores,
    /// Attendance pruning, where stage two was reached.
    pub pruned: Option<Pruned>,
    /// Association, where settings ask for it and training views have raw labels.
    pub association: Option<Associated>,
    /// What the classes of objects are scored against, where association found objects with classes.
    pub semantics: Option<Semantics>,
    /// Rows of the label table, in the order of the configuration; empty without labels.
    pub rows: Vec<VariantOutcome>,
    /// Where the 2D features came from; empty when none were needed.
    pub features: String,
    /// Where the point encoder came from; empty when none was needed.
    pub spatial: String,
    /// Where the time went.
    pub seconds: Seconds,
    /// The settings as they ran: where none named the rows, those that were chosen.
    pub config: Config,
    /// Whether `progress` ended the run before it was done. What it had not come to is empty here, a row that it was in the
    /// middle of has no identities, and half-built Gaussians have no scores; [`run`] goes on with it.
    pub stopped: bool,
    /// Seconds of training in stage two that earlier parts of a resumed run took.
    earlier_segmentation: f64,
}

impl Outcome {
    /// Whether to do nothing more: the run was stopped, or is now.
    fn stops(&mut self, progress: &mut dyn Progress) -> bool {
        self.stopped = self.stopped || progress.stop();
        self.stopped
    }

    /// The row whose identities the scene stores: `ours` where it was trained, else the last with identities.
    pub fn stored(&self) -> Option<(&VariantOutcome, &Identities)> {
        let with = |row: &VariantOutcome| row.identities.is_some();
        let row = self.rows.iter().find(|r| r.row == Variant::Ours && with(r));
        let row = row.or_else(|| self.rows.iter().rfind(|r| with(r)))?;
        Some((row, row.identities.as_ref()?))
    }

    /// Size of the learned parts in bytes: (name, bytes).
    pub fn learnable_bytes(&self) -> Vec<(String, u64)> {
        let g = &self.gaussians;
        let floats = g.len() * (3 + 3 + 4 + 1 + 3 * g.sh_len());
        let mut parts = vec![("gaussians".to_owned(), 4 * floats as u64)];
        for row in &self.rows {
            if row.learnable_bytes > 0 {
                parts.push((row.name().to_owned(), row.learnable_bytes as u64));
            }
        }
        parts
    }
}

/// The scene that `config.data` names: a folder, or the built-in scene.
///
/// # Errors
/// Those of the loader, each naming file and field.
pub fn load_scene(config: &Config) -> Result<Scene> {
    load(config, |config| LoadOptions::from(config))
}

fn load(config: &Config, options: impl FnOnce(&Config) -> LoadOptions) -> Result<Scene> {
    match &config.data.dir {
        None => Ok(builtin::scene(builtin::EVALUATED_SEED)),
        Some(dir) => data::load(dir, &options(config)),
    }
}

/// Runs both stages, or as much of them as `progress` does not stop. Checkpoints go to and come from `out/checkpoint`; a run
/// that finds its own there goes on.
///
/// # Errors
/// Those of loading, of both stages, and of writing; nothing written before is lost.
pub fn run(
    config: &Config,
    out: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Outcome> {
    let start = Instant::now();
    let scene = load(config, LoadOptions::for_training)?;
    let config = &match &config.segmentation.rows {
        None => {
            // As stage two will know them: association has yet to come.
            let semantics = Semantics::of(&scene);
            let scored = |view: &View| has_truth(view, config.data.association, semantics.as_ref());
            let scored = scene.split(Split::Test).any(scored);
            let rows = Some(if scored {
                Variant::COMPARED.to_vec()
            } else {
                Variant::UNSCORED.to_vec()
            });
            Config {
                segmentation: SegmentationConfig {
                    rows,
                    ..config.segmentation.clone()
                },
                ..config.clone()
            }
        }
        Some(_) => config.clone(),
    };
    if !config.segmentation.rows().is_empty() && !has_raw_labels(&scene) {
        tracing::warn!(
            "no training view has raw labels: only the Gaussians are built (raw_label_path in transforms.json or the folder \
             data.raw_labels names them; segmentation.rows = [] says that none are meant)"
        );
    }
    let settings = Settings::from(&config.raster);
    let (checkpoints, scene_file) = (out.join("checkpoint"), out.join("scene.ply"));
    // Before anything is written: a file that cannot be begun with leaves no run behind.
    let begun = match &config.building.gaussians {
        Some(path) if !checkpoints.join(BUILDING).is_file() || config.building.iterations == 0 => {
            Some(begin(path, &scene, config, &scene_file, device)?)
        }
        _ => None,
    };
    std::fs::create_dir_all(&checkpoints).map_err(|e| Error::io(&checkpoints, "create", e))?;
    let mut seconds = Seconds::default();

    let clock = Instant::now();
    let Built {
        gaussians,
        curve: building,
        earlier,
        anew,
        whole,
    } = match begun {
        Some(gaussians) if config.building.iterations == 0 => {
            taken(gaussians, &scene, config, &checkpoints)?
        }
        begun => build(&scene, config, begun, &checkpoints, device, progress)?,
    };
    // What a finished run wrote stays until another result is there.
    if anew || !scene_file.exists() {
        ply::write(&scene_file, &gaussians, scene.origin, None)?;
    }
    seconds.building = clock.elapsed().as_secs_f64() + earlier;

    // Whoever stops a run is not kept waiting.
    let test = if whole {
        score_images(&gaussians, &scene, config, device)?
    } else {
        ImageScores::default()
    };
    let mut outcome = Outcome {
        gaussians,
        building,
        test,
        pruned: None,
        association: None,
        semantics: None,
        rows: Vec::new(),
        features: String::new(),
        spatial: String::new(),
        seconds,
        config: config.clone(),
        stopped: !whole,
        earlier_segmentation: 0.0,
        scene,
    };
    let segments = config.data.association == Association::Gaussians;
    if segments
        && outcome.scene.split(Split::Train).any(|v| v.raw.is_some())
        && !outcome.stops(progress)
    {
        put_together(&mut outcome, progress)?;
    }
    if has_raw_labels(&outcome.scene)
        && !config.segmentation.rows().is_empty()
        && !outcome.stops(progress)
    {
        outcome.seconds.segmentation =
            segment(&mut outcome, &settings, &checkpoints, device, progress)?;
    }
    outcome.seconds.total = start.elapsed().as_secs_f64() + earlier + outcome.earlier_segmentation;
    Ok(outcome)
}

/// Whether stage two has something to train on.
fn has_raw_labels(scene: &Scene) -> bool {
    scene.split(Split::Train).any(|view| view.raw.is_some()) && !scene.classes.is_empty()
}

/// What stage one gave.
struct Built {
    /// In spatial order.
    gaussians: Gaussians,
    curve: Vec<CurvePoint>,
    /// Seconds of it that earlier parts of a resumed run took.
    earlier: f64,
    /// Whether this part of the run did any of it.
    anew: bool,
    /// Whether it is done; otherwise it was stopped.
    whole: bool,
}

/// Checkpoint of stage one.
const BUILDING: &str = "building.safetensors";
/// What stage one came from where its Gaussians were taken as they are.
const GIVEN: &str = "given.safetensors";
/// Kind of that checkpoint.
const GIVEN_KIND: &str = "given Gaussians";

/// Stage one that takes `gaussians` as they are. A run that goes on has to have begun with them, and with these photos.
fn taken(
    gaussians: Gaussians,
    scene: &Scene,
    config: &Config,
    checkpoints: &Path,
) -> Result<Built> {
    let (built, file) = (checkpoints.join(BUILDING), checkpoints.join(GIVEN));
    let provenance = Provenance::given(config, scene, &gaussians);
    if built.is_file() {
        provenance.check_built(&BuildingState::load(&built)?.provenance, scene, &built)?;
    }
    let anew = !file.is_file();
    if anew {
        let mut checkpoint = Checkpoint::new(GIVEN_KIND);
        checkpoint.set("provenance", &provenance)?;
        checkpoint.save(&file)?;
    } else {
        provenance.check_built(
            &Checkpoint::load(&file, GIVEN_KIND)?.get("provenance")?,
            scene,
            &file,
        )?;
    }
    let gaussians = gaussians.select(&gaussians.spatial_order());
    Ok(Built {
        gaussians,
        curve: Vec::new(),
        earlier: 0.0,
        anew,
        whole: true,
    })
}

/// Stage one from its checkpoint, or from the Gaussians `begun`, or from points.
fn build(
    scene: &Scene,
    config: &Config,
    begun: Option<Gaussians>,
    checkpoints: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<Built> {
    let (checkpoint, given) = (checkpoints.join(BUILDING), checkpoints.join(GIVEN));
    if given.is_file() {
        let stored = Checkpoint::load(&given, GIVEN_KIND)?.get("provenance")?;
        Provenance::building(config, scene).check_built(&stored, scene, &given)?;
    }
    let mut stage = match (checkpoint.is_file(), begun) {
        (true, _) => {
            BuildingStage::from_state(scene, config, device, BuildingState::load(&checkpoint)?)?
        }
        (false, Some(gaussians)) => {
            let gaussians = gaussians.with_sh_degree(config.building.sh_degree);
            BuildingStage::from_state(
                scene,
                config,
                device,
                BuildingState::new(gaussians, config.seed),
            )?
        }
        (false, None) => BuildingStage::new(scene, config, device)?,
    }
    .checkpoint_at(checkpoint);
    let (earlier, before) = (stage.seconds(), stage.iteration());
    stage.run(progress)?;
    let gaussians = stage.gaussians()?;
    Ok(Built {
        gaussians: gaussians.select(&gaussians.spatial_order()),
        curve: stage.curve().to_vec(),
        earlier,
        anew: stage.iteration() > before,
        whole: stage.iteration() >= config.building.iterations,
    })
}

/// Makes objects of the segments that the raw labels of the scene hold, unless it is stopped before they are. They are not
/// stored: a run that is gone on with makes them again, and the same ones.
fn put_together(outcome: &mut Outcome, progress: &mut dyn Progress) -> Result<()> {
    let Outcome {
        scene,
        gaussians,
        config,
        ..
    } = outcome;
    let (clock, settings) = (Instant::now(), Settings::from(&config.raster));
    let looks = objects::Association::looks(scene, &config.association);
    let mut viewing = Viewing::begin(progress, "association", looks);
    let looked = &mut |views| viewing.looked(views);
    let ControlFlow::Continue(found) =
        associate_until(gaussians, scene, &config.association, &settings, looked)?
    else {
        outcome.stopped = true;
        return Ok(());
    };
    viewing.end();
    let (segments, objects) = (found.segments, found.groups.len());
    let (dropped, divided) = (found.dropped, found.divided);
    // Before the true labels that it is made of leave the scene.
    outcome.semantics = Semantics::of(scene);
    found.apply(scene);
    let seconds = clock.elapsed().as_secs_f64();
    outcome.association = Some(Associated {
        segments,
        objects,
        dropped,
        divided,
        seconds,
    });
    Ok(())
}

/// Stage two; returns its seconds, those that earlier parts of a resumed run took included.
fn segment(
    outcome: &mut Outcome,
    settings: &Settings,
    checkpoints: &Path,
    device: &Device,
    progress: &mut dyn Progress,
) -> Result<f64> {
    let config = &outcome.config.clone();
    let attendance = Attendance::of(
        &outcome.scene,
        &outcome.gaussians,
        config,
        settings,
        device,
        progress,
    )?;
    let (Some(attendance), false) = (attendance, progress.stop()) else {
        outcome.stopped = true;
        return Ok(0.0);
    };
    let seen = attendance.apply(outcome, device)?;
    let clock = Instant::now();
    let inputs = Inputs {
        scene: &outcome.scene,
        gaussians: &outcome.gaussians,
        seen,
        semantics: outcome.semantics.as_ref(),
        config,
        settings: *settings,
        device,
    };
    let TrainedRows {
        rows,
        spatial,
        earlier,
        stopped,
    } = run_rows(&inputs, checkpoints, progress)?;
    (outcome.rows, outcome.spatial, outcome.earlier_segmentation) = (rows, spatial, earlier);
    outcome.stopped = stopped;
    Ok(clock.elapsed().as_secs_f64() + earlier)
}
