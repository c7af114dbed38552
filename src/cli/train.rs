//! `coseg train`: the main job.

use super::progress::Bars;
use super::run_folder::RunFolder;
use super::scene_file::scene_path;
use super::{Settings, interrupt, terminal};
use clap::Args;
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::config::{Config, Variant};
use coseg::data;
use coseg::data::formats::transforms;
use coseg::data::{LoadOptions, NamedCamera, Split, View, atomic};
use coseg::error::Result;
use coseg::pipeline;
use coseg::pipeline::{Outcome, VariantOutcome};
use coseg::report::{Command, Metrics, Report, held_out_views};
use coseg::splat::camera::Camera;
use coseg::splat::ply;
use coseg::viewer::Viewer;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

/// Bytes of a viewer.html that nobody asked for, at most: 1.1 million Gaussians of SH degree 3.
const LARGEST_PAGE: usize = 128_000_000;

const HELP: &str = "\
Stage one builds Gaussians from the photos; stage two learns from the raw label maps what each of them belongs to.

The run folder gets
  scene.ply      the Gaussians in the 3DGS convention, with a label column
  report.html    curves, pictures, tables; one page that needs nothing else
  viewer.html    the scene, to walk through in a browser; beyond 128 MB, 111 bytes a Gaussian, `coseg view` writes it
  metrics.json   the same figures for programs
  classes.json   id, name and colour of each class
  cameras.json   the views as a transforms.json, for render and objects
  config.toml    all settings as run
  renders/       held-out views: colour, labels, error maps
  checkpoint/    what --resume goes on from

Ctrl-C, or SIGTERM, saves a checkpoint and stops after the step or view; a second one stops at once. The report and all else that
shows results is written when the run is done.

Settings come from the preset (preset = \"default\", \"paper\" or \"fast\"), then --config, then --set; sections are
data, association, building, raster, features, unprojection, spatial and segmentation. Relative paths are meant from the working
folder. Times are seconds, lengths world units, shares 0 to 1.

Without --data and data.dir the built-in room is trained, with building.iterations = 2400, building.max_gaussians = 25000 and
segmentation.pixel_share = 0.25 in place of the usual defaults; presets (\"paper\" takes none of these), --config and --set
come on top.

Examples:
  coseg train
  coseg train --data scenes/living --set data.raw_labels=labels_raw --set segmentation.rows=raw,vote,ours
  coseg train --config configs/fox.toml --data scenes/fox --out runs/fox
  coseg train --data scenes/fox --set features.source=dino --set features.weights=dino_deitsmall8_pretrain.pth
  coseg train --data scenes/fox --scene other/point_cloud.ply          stage two alone, on Gaussians of another trainer
  coseg train --data scenes/fox --scene other/point_cloud.ply --set building.iterations=2000      trained further first
  coseg train --resume runs/fox
  coseg train --resume runs/fox --data elsewhere/fox                   its scene has moved";

/// Arguments of `coseg train`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct TrainArgs {
    /// Scene folder: photos, cameras, label maps; README, 'Data' [default: the built-in room]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// 3DGS PLY of this or another trainer whose Gaussians to label, instead of building new ones
    #[arg(long, value_name = "FILE.ply|RUN", conflicts_with = "resume")]
    scene: Option<PathBuf>,
    /// Run folder to write [default: runs/NAME of the scene, numbered when taken]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Go on with this run from its last checkpoint, as if it had not stopped; --data if its scene moved
    #[arg(long, value_name = "RUN", conflicts_with_all = ["out", "seed", "config"])]
    resume: Option<PathBuf>,
    /// Where to compute: wgpu, flex, ndarray or cuda [default: the first in this build, cuda aside]
    #[arg(long, value_name = "NAME")]
    backend: Option<BackendName>,
    /// Seed of every random choice [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    #[command(flatten)]
    settings: Settings,
}

impl TrainArgs {
    /// Trains, or goes on training, and writes the run folder, unless it is stopped before.
    pub fn run(mut self) -> Result<ExitCode> {
        if let Some(path) = &self.scene {
            // Ahead of what `--set` says. All Gaussians of the file come back.
            let sets = [
                "building.iterations=0",
                "building.max_gaussians=0",
                "unprojection.attendance=0",
            ];
            let sets = sets.map(str::to_owned);
            let sets = sets.into_iter().chain([format!(
                "building.gaussians={}",
                scene_path(path)?.display()
            )]);
            self.settings.sets.splice(0..0, sets);
        }
        let (run, config) = match &self.resume {
            Some(dir) => {
                let run = RunFolder::existing(dir)?;
                let mut config = run.config(&self.settings.sets)?;
                config.data.dir = self.data.clone().or(config.data.dir);
                (run, config)
            }
            None => {
                let config = self.settings.load(self.data.as_ref(), self.seed)?;
                (
                    RunFolder::new(self.out.as_deref(), &scene_name(&config))?,
                    config,
                )
            }
        };
        // A run is gone on with, and scored, from other folders too.
        let config = config.with_absolute_paths()?;
        if let Some(dir) = &config.data.dir {
            data::locate(dir, &LoadOptions::from(&config))?;
        }
        let (backend, device) = device::choose(self.backend)?;
        let device_text = format!(
            "{} backend, {} threads",
            device::described(backend),
            rayon::current_num_threads()
        );
        terminal::note(&format!(
            "{} -> {} ({device_text})",
            scene_name(&config),
            run.path().display()
        ));

        interrupt::watch();
        let version = env!("CARGO_PKG_VERSION").to_owned();
        let begun = run.begin(
            &config,
            Command {
                line: command_line(),
                device: device_text,
                version,
            },
        )?;
        let outcome = pipeline::run(&config, run.path(), &device, &mut Bars::default());
        let outcome = outcome.inspect_err(|_| begun.undo())?;
        begun.keep()?;
        if outcome.stopped {
            terminal::note(&format!("stopped; go on with: {}", self.resume_line(&run)));
            return Ok(ExitCode::from(interrupt::EXIT));
        }
        let config = &outcome.config;
        let labels = outcome.stored().map(|(_, identities)| identities);
        let ids = labels.map(|identities| identities.ids(&outcome.scene.classes));
        if labels.is_none() {
            // Those of an earlier result, which had other rows.
            atomic::remove(run.identities_path())?;
        }
        ply::write(
            &run.scene_path(),
            &outcome.gaussians,
            outcome.scene.origin,
            ids.as_deref(),
        )?;
        let cameras = cameras_of(&outcome);
        transforms::write_cameras(&run.cameras_path(), &cameras)?;
        let viewer = Viewer {
            title: &scene_name(config),
            scene: &run.path().display().to_string(),
            names: None,
            gaussians: &outcome.gaussians,
            origin: outcome.scene.origin,
            labels: ids.as_deref(),
            classes: &outcome.scene.classes,
            cameras: &cameras,
            // Where the scene says so; else as for other scenes.
            up: Some(outcome.scene.up).filter(|up| *up == DVec3::Z),
            alpha_max: config.raster.alpha_max,
        };
        let page_bytes = Viewer::bytes(&outcome.gaussians);
        let shown = match page_bytes <= LARGEST_PAGE {
            true => {
                viewer.write(&run.viewer_path())?;
                format!("viewer: {}", run.viewer_path().display())
            }
            false => {
                // That of an earlier result.
                atomic::remove(run.viewer_path())?;
                let megabytes = page_bytes / 1_000_000;
                let line = [
                    "coseg",
                    "view",
                    "--scene",
                    &run.path().display().to_string(),
                ]
                .map(str::to_owned)
                .map(quoted);
                format!("viewer: {megabytes} MB, which `{}` writes", line.join(" "))
            }
        };
        if let Some(identities) = labels {
            identities.write(&run.identities_path())?;
        }
        let (classes, renders) = (&outcome.scene.classes, run.path().join("renders"));
        let mut metrics = Metrics {
            commands: begun.commands,
            ..Metrics::of(&outcome)
        };
        let mut scores = BTreeMap::new();
        let views = held_out_views(&outcome, config, &device, |view| {
            scores.insert(view.view.name.clone(), view.scores);
            view.write(classes, &renders)
        })?;
        scores.extend(
            views
                .iter()
                .map(|view| (view.view.name.clone(), view.scores)),
        );
        metrics.test.views = scores;
        // Of a run in parts the largest counts, as far as they came to an end.
        metrics.peak_memory_bytes = metrics.peak_memory_bytes.max(run.peak_memory_before());
        let report = Report {
            metrics,
            classes,
            config,
            held_out: outcome.scene.split(Split::Test).count(),
            views,
            notes: Report::notes_of(&outcome, config),
        };
        report.write(run.path())?;
        summary(&outcome);
        terminal::say(&format!("report: {}", run.report_path().display()));
        terminal::say(&shown);
        Ok(ExitCode::SUCCESS)
    }

    /// The command line that goes on with `run`. Settings that a finished run is gone on with are its own only once it is done
    /// again.
    fn resume_line(&self, run: &RunFolder) -> String {
        let mut words = ["coseg", "train", "--resume"].map(str::to_owned).to_vec();
        words.push(run.path().display().to_string());
        if self.resume.is_some() {
            words.extend(
                self.data
                    .iter()
                    .flat_map(|dir| ["--data".to_owned(), dir.display().to_string()]),
            );
            words.extend(
                self.settings
                    .sets
                    .iter()
                    .flat_map(|set| ["--set".to_owned(), set.clone()]),
            );
        }
        words.extend(
            self.backend
                .iter()
                .flat_map(|name| ["--backend".to_owned(), name.to_string()]),
        );
        words.into_iter().map(quoted).collect::<Vec<_>>().join(" ")
    }
}

/// The views' cameras in world units.
fn cameras_of(outcome: &Outcome) -> Vec<NamedCamera> {
    let origin = outcome.scene.origin;
    let camera = |view: &View| Camera {
        center: view.camera.center + origin,
        ..view.camera.clone()
    };
    let named = |view: &View| NamedCamera {
        name: view.name.clone(),
        split: view.split,
        camera: camera(view),
    };
    outcome.scene.views.iter().map(named).collect()
}

/// Name of the scene, for the run folder.
fn scene_name(config: &Config) -> String {
    let dir = config
        .data
        .dir
        .as_deref()
        .map(|dir| dir.canonicalize().unwrap_or_else(|_| dir.to_owned()));
    let name = dir
        .as_deref()
        .and_then(|dir| dir.file_name())
        .map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| {
        if config.data.dir.is_some() {
            "scene".into()
        } else {
            "builtin".into()
        }
    })
}

/// This command line, quoted where a shell would need it.
fn command_line() -> String {
    std::iter::once("coseg".to_owned())
        .chain(std::env::args().skip(1).map(quoted))
        .collect::<Vec<_>>()
        .join(" ")
}

/// A word of a command line as a shell takes it.
fn quoted(word: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+".contains(c);
    if word.chars().all(plain) {
        word
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// The headline figures, for those who do not open the page.
fn summary(outcome: &Outcome) {
    if let (Some(psnr), Some(ssim)) = (outcome.test.psnr, outcome.test.ssim) {
        terminal::say(&format!(
            "held-out PSNR {psnr:.2} dB, SSIM {ssim:.4}, {} Gaussians, {:.0} s",
            outcome.gaussians.len(),
            outcome.seconds.total
        ));
    }
    if let Some(a) = &outcome.association {
        terminal::say(&format!(
            "{} segments put together into {} objects, {} of none, {} divided; scores are against true instances",
            a.segments, a.objects, a.dropped, a.divided
        ));
    }
    if outcome.rows.is_empty() {
        return;
    }
    let scored = |row: &VariantOutcome| {
        row.scores.miou.is_some() || row.instances.is_some() || row.semantic.is_some()
    };
    if !outcome.rows.iter().any(scored) {
        let names: Vec<&str> = outcome.rows.iter().map(|row| row.row.title()).collect();
        terminal::say(&format!(
            "labels: {}; not scored, as no held-out view has true labels",
            names.join(", ")
        ));
        return;
    }
    terminal::say(&format!(
        "{:<28} {:>8} {:>9} {:>9}",
        "row", "mIoU", "per view", "accuracy"
    ));
    let cell = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}"));
    for row in &outcome.rows {
        let name = if row.row == Variant::Ours {
            "ours"
        } else {
            row.row.title()
        };
        let s = &row.scores;
        let [miou, per_view, accuracy] = match &row.instances {
            Some(s) => [s.miou, None, s.accuracy],
            None => [s.miou, s.miou_per_view, s.accuracy],
        };
        terminal::say(&format!(
            "{name:<28} {:>8} {:>9} {:>9}",
            cell(miou),
            cell(per_view),
            cell(accuracy)
        ));
        if let Some(s) = &row.semantic {
            let [miou, per_view, accuracy] = [s.miou, s.miou_per_view, s.accuracy].map(cell);
            let name = format!("{name}, by class");
            terminal::say(&format!("{name:<28} {miou:>8} {per_view:>9} {accuracy:>9}"));
        }
    }
}
