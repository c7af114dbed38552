//! `coseg train`: the main job.

use super::held_out;
use super::label::{BEST, SegmenterArgs};
use super::progress::Bars;
use super::{BackendArgs, Settings, interrupt, or_usage_error, terminal};
use clap::Args;
use coseg::config::{Config, FeatureSource};
use coseg::data::LoadOptions;
use coseg::error::{Error, Result, bail, ensure};
use coseg::files::{own, shell_word};
use coseg::pipeline::{Outcome, VariantOutcome};
use coseg::progress::{Event, Progress};
use coseg::ranks;
use coseg::report::Command;
use coseg::runs::{
    REPORT, RunFolder, RunOptions, VIEWER, check_folder, correct, follow, scene_name, train,
};
use coseg::viewer::MAX_PAGE_BYTES;
#[cfg(feature = "serve")]
use coseg::watch::Watched;
#[cfg(feature = "serve")]
use std::net::IpAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

const HELP: &str = "\
Stage one builds Gaussians from the photos. Stage two learns from the raw label maps what each Gaussian belongs to.

The run folder gets
  scene.ply      the Gaussians in the 3DGS convention, with a label column
  report.html    curves, pictures, tables; one page that needs nothing else
  viewer.html    the scene, to walk through in a browser, up to 128 MB (120 bytes a Gaussian); `coseg view` writes larger ones
  metrics.json   the same figures for programs
  classes.json   id, name and colour of each class
  cameras.json   the views as a transforms.json, for render and objects
  config.toml    all settings as run
  feature_colors.safetensors  colours by image features, for render --features pca; where a variant reads these
  renders/       held-out views: colour, labels, error maps
  labels/        with --segmenter: label maps and scores of all photos, as `coseg label` writes them
  checkpoint/    the state that --resume continues from

Ctrl-C, or SIGTERM, saves a checkpoint and stops after the step or view; a second one stops at once. The report and the other
results are written when the run is done.

Settings come from the preset (preset = \"default\" or \"paper\"), then --config, then --set. Their sections are
data, building, raster, features, unprojection, spatial and segmentation. Relative paths start at the working folder. Times are
in seconds, lengths in world units, shares from 0 to 1.

Without --data and data.dir, `coseg train` trains the built-in room. Its default for
building.iterations is 2400. The preset \"paper\" keeps its own value, and --config and --set override both.

Examples:
  coseg train
  coseg train --data scenes/living --set data.raw_labels=labels_raw --set segmentation.rows=raw,vote,ours
  coseg train --config configs/fox.toml --data scenes/fox --out runs/fox
  coseg train --data scenes/fox --set features.source=dino --set features.weights=dino_deitsmall8_pretrain.pth
  coseg train --data scenes/fox --segmenter net.onnx --classes mine.toml      photos alone: labels them first
  coseg train --data scenes/fox --scene other/point_cloud.ply          stage two alone, on Gaussians of another trainer
  coseg train --data scenes/fox --scene other/point_cloud.ply --set building.iterations=2000      trained further first
  coseg train --data scenes/fox --scene splat.ply --set data.dataparser_transforms=FILE           nerfstudio's, in its world
  coseg train --data scenes/fox --view                                 shows the scene as it grows (feature `serve`)
  mpirun -n 4 coseg train --data scenes/fox                            on four processes (feature `mpi`, docs/scale.md)
  coseg train --resume runs/fox
  coseg train --resume runs/fox --corrections edits.json               labels corrected in its page count as true
  coseg train --resume runs/fox --data elsewhere/fox                   its scene has moved";

/// Arguments of `coseg train`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct TrainArgs {
    /// Scene folder with photos, cameras and label maps [default: the built-in room]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Label these Gaussians instead of new ones: a PLY, .spz, .sog or .splat file, or its folder
    #[arg(long, value_name = "FILE|DIR", conflicts_with = "resume")]
    scene: Option<PathBuf>,
    /// Label the photos first by this segmenter (`coseg label --help`), into labels/ of the run folder
    #[arg(long, value_name = "FILE.onnx", conflicts_with = "resume")]
    segmenter: Option<PathBuf>,
    #[command(flatten)]
    labelling: SegmenterArgs,
    /// Run folder to write [default: runs/NAME of the scene, with a number if that is taken]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Continue this run from its last checkpoint; add --data if its scene has moved
    #[arg(long, value_name = "RUN", conflicts_with_all = ["out", "seed", "config"])]
    resume: Option<PathBuf>,
    /// Train again on labels that you corrected in the page of this run; see docs/edits.md
    #[arg(long, value_name = "FILE.json", requires = "resume", conflicts_with_all = ["out", "seed", "config"])]
    corrections: Option<PathBuf>,
    /// Serve a page on which a browser on this machine watches the run; its address is printed
    #[cfg(feature = "serve")]
    #[arg(long)]
    view: bool,
    /// The address of this machine that the page is served on
    #[cfg(feature = "serve")]
    #[arg(
        long,
        value_name = "IP",
        requires = "view",
        default_value = "127.0.0.1"
    )]
    listen: IpAddr,
    /// Seed of every random choice [default: 0]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    settings: Settings,
}

impl TrainArgs {
    /// Trains or resumes, and writes the run folder unless the run is stopped.
    pub fn run(self) -> Result<ExitCode> {
        if ranks::index() > 0 {
            return self.follow();
        }
        let (run, config) = self.run_and_config()?;
        check_folder(&run, &config)?;
        let _lock = run.claim(self.resume.is_some())?;
        self.train(&run, config)
            .inspect_err(|_| own::remove_empty(run.path()))
    }

    /// Trains as a rank other than the first, which reads the options, writes the files and prints.
    fn follow(self) -> Result<ExitCode> {
        let device = self.backend.open()?;
        interrupt::watch(interrupt::CHECKPOINT);
        match follow(&device, &mut Following) {
            // `mpirun` ends all ranks once one fails, and the first has yet to say how to continue the run.
            Ok(()) | Err(Error::Stopped) => Ok(ExitCode::SUCCESS),
            Err(error) => {
                // The first one mostly meets the same error. It has to say so, and to remove what it began.
                std::thread::sleep(Duration::from_secs(2));
                Err(error)
            }
        }
    }

    /// Trains in the folder `run`.
    fn train(self, run: &RunFolder, mut config: Config) -> Result<ExitCode> {
        let (device_text, device) = self.backend.choose_with_threads()?;
        terminal::note(&format!(
            "{} -> {} ({device_text})",
            scene_name(&config),
            run.path().display()
        ));
        interrupt::watch(match self.segmenter {
            Some(_) => interrupt::PHOTO_OR_STEP,
            None => interrupt::CHECKPOINT,
        });
        self.label(run, &mut config)?;
        if let Some(edits) = &self.corrections {
            let count = correct(run, edits, &config)?;
            terminal::note(&format!("Gaussians with corrected labels: {count}"));
        }
        let command = Command {
            line: command_line(),
            device: device_text,
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let mut progress = self.progress(&config)?;
        let trained = match train(run, &config, command, &device, &mut *progress) {
            Err(Error::Stopped) => {
                let line = self.resume_line(run);
                return Ok(interrupt::stopped(&format!("resume with: {line}")));
            }
            trained => trained?,
        };
        summary(&trained.outcome);
        terminal::say(&format!("report: {}", run.file(REPORT).display()));
        terminal::say(&viewer_line(run, trained.page_bytes));
        Ok(ExitCode::SUCCESS)
    }

    /// Who listens to the run: the terminal, and a browser where `--view` asks for it.
    fn progress(&self, config: &Config) -> Result<Box<dyn Progress>> {
        let bars = Bars::default();
        #[cfg(not(feature = "serve"))]
        let _ = config;
        #[cfg(feature = "serve")]
        if self.view {
            let alpha_max = config.raster.alpha_max;
            let watch = Watched::start(self.listen, &scene_name(config), alpha_max, bars)?;
            terminal::note(&format!("watch: {}", watch.address()));
            return Ok(Box::new(watch));
        }
        Ok(Box::new(bars))
    }

    /// Labels the photos by the segmenter, if one is given; its labels become the raw ones.
    fn label(&self, run: &RunFolder, config: &mut Config) -> Result<()> {
        let Some(model) = &self.segmenter else {
            return self.labelling.expect_none();
        };
        let Some(dir) = &config.data.dir else {
            bail!(argument "--segmenter"; found "the built-in room";
                expected "a scene folder whose photos it labels"; help "add --data DIR");
        };
        let labels = run.path().join("labels");
        let scene = (dir.as_path(), &LoadOptions::from(&*config));
        self.labelling.label(scene, model, BEST, &labels)?;
        let labels = labels.canonicalize().unwrap_or(labels);
        config.data.raw_labels = labels.display().to_string();
        let features = &mut config.features;
        let is_same = features
            .weights
            .as_ref()
            .is_some_and(|file| file.canonicalize().ok() == model.canonicalize().ok());
        if matches!(features.source, FeatureSource::Segmenter(_)) && is_same {
            let contract = self.labelling.contract.clone();
            features.contract = features.contract.take().or(contract);
            *config = config.clone().with_absolute_paths()?;
        }
        Ok(())
    }

    /// The run folder and the settings. Faults of the options end the program as clap does.
    fn run_and_config(&self) -> Result<(RunFolder, Config)> {
        let options = RunOptions {
            data: self.data.clone(),
            scene: self.scene.clone(),
            out: self.out.clone(),
            resume: self.resume.clone(),
            config: self.settings.config.clone(),
            sets: self.settings.sets.clone(),
            seed: self.seed,
        };
        let opened = options.open().and_then(|(run, config)| {
            let labels = &config.data.raw_labels;
            ensure!(self.segmenter.is_none() || labels.is_empty(), setting "data.raw_labels"; found "{labels:?}";
                expected "none beside --segmenter, which makes the raw labels"; help "give one of the two");
            Ok((run, config))
        });
        // Without --set, the settings of a resumed run come from its folder, not from options.
        if self.resume.is_some() && self.settings.sets.is_empty() {
            opened
        } else {
            or_usage_error(opened)
        }
    }

    /// The command line that resumes `run`. A resumed run stores settings of `--set` only when it is done, so the line repeats
    /// them.
    fn resume_line(&self, run: &RunFolder) -> String {
        let mut words = ["coseg", "train", "--resume"].map(str::to_owned).to_vec();
        words.push(run.path().display().to_string());
        let mut option = |name: &str, value: String| words.extend([name.to_owned(), value]);
        if self.resume.is_some() {
            if let Some(dir) = &self.data {
                option("--data", dir.display().to_string());
            }
            for set in &self.settings.sets {
                option("--set", set.clone());
            }
        }
        if let Some(name) = self.backend.backend {
            option("--backend", name.to_string());
        }
        words
            .into_iter()
            .map(shell_word)
            .collect::<Vec<_>>()
            .join(" ")
    }
}

/// Listens to the run of another rank.
struct Following;

impl Progress for Following {
    fn event(&mut self, _: &Event) {}

    fn stop(&mut self) -> bool {
        interrupt::stop_requested()
    }
}

/// Where the page of the scene is, or how to get it.
fn viewer_line(run: &RunFolder, page_bytes: usize) -> String {
    if page_bytes <= MAX_PAGE_BYTES {
        return format!("viewer: {}", run.file(VIEWER).display());
    }
    let megabytes = page_bytes / 1_000_000;
    let folder = shell_word(run.path());
    format!("viewer: left out, as it takes {megabytes} MB; `coseg view --scene {folder}` writes it")
}

/// This command line, quoted where a shell would need it. What is not Unicode is shown as U+FFFD.
pub fn command_line() -> String {
    let words = std::env::args_os().skip(1);
    std::iter::once("coseg".to_owned())
        .chain(words.map(shell_word))
        .collect::<Vec<_>>()
        .join(" ")
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
    if let Some(traffic) = &outcome.traffic {
        terminal::say(&format!(
            "{} ranks; each put {:.1} MB into the sums of a step of stage one, {:.0} MB in all of it, and {:.0} MB afterwards",
            traffic.ranks,
            traffic.building_step_bytes as f64 / 1e6,
            traffic.building_bytes as f64 / 1e6,
            traffic.segmentation_bytes as f64 / 1e6,
        ));
    }
    if let Some(counts) = &outcome.association {
        let mut scores = outcome.rows.iter().map(|row| &row.scores);
        let scored = if scores.any(|scores| scores.instances.is_some()) {
            "; scores are against true instances"
        } else {
            ""
        };
        terminal::say(&format!("{counts}{scored}"));
    }
    if outcome.rows.is_empty() {
        return;
    }
    let is_scored = |row: &VariantOutcome| {
        let scores = &row.scores;
        scores.labels.pixels.miou.is_some()
            || scores.instances.is_some()
            || scores.semantic.is_some()
    };
    if !outcome.rows.iter().any(is_scored) {
        let names: Vec<&str> = outcome.rows.iter().map(|row| row.variant.title()).collect();
        terminal::say(&format!(
            "labels: {}; not scored, as no held-out view has true labels",
            names.join(", ")
        ));
        return;
    }
    for row in &outcome.rows {
        held_out::print(&row.scores, row.variant.title());
    }
}
