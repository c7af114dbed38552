//! `coseg bench`: speed against error, times of the stages, memory.

use super::run_folder::RunFolder;
use super::scene_file::{cameras_path, scene_path};
use super::{Settings, terminal};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::bench::{Bench, Effort, Findings, Machine, Section, Source, Subject};
use coseg::data::atomic;
use coseg::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Passes behind a median, and those of --quick.
const REPEATS: [usize; 2] = [5, 1];
/// Numbers of Gaussians where no trained scene has a number of its own, and that of --quick.
const UNTRAINED: [usize; 2] = [10_000, 100_000];
const QUICK: usize = 300;

const HELP: &str = "\
Sections
  raster        rendering of colour, colour and 20 classes, and 64 channels, forward and with the backward pass,
                at 480x360 and 1920x1080
  curve         each setting of the rasterizer changed alone: its time, and its error against exact f64
  building      a step of stage one on the scene's photos
  unprojection  4 x 64 feature channels lifted onto the Gaussians from 80 views
  segmentation  a step of stage two, where the scene has raw labels

Each figure is a median with the smallest and the largest measurement; a warm-up is not counted. Each section ends with
its peak memory. Close other programs first: the first lines say whether the machine is busy.

Without --run or --scene nothing is trained, and the Gaussians are those that training would start from. With
--gaussians a scene is resampled: to fewer and larger Gaussians, or to more and smaller ones.

Examples:
  coseg bench                                              some minutes on two cores
  coseg bench --run runs/living --json living.json
  coseg bench --run runs/living --gaussians 100000,1000000 --only raster
  coseg bench --only building --data scenes/fox --set data.transforms=transforms_4.json
  coseg bench --only raster,curve --scene scene.ply --cameras transforms.json";

/// Arguments of `coseg bench`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct BenchArgs {
    /// Sections to measure, separated by commas [default: all]
    #[arg(long, value_name = "SECTION,...", value_delimiter = ',')]
    only: Vec<Section>,
    /// Scene folder with photos [default: the built-in room]
    #[arg(long, value_name = "DIR", conflicts_with = "scene")]
    data: Option<PathBuf>,
    /// Folder that `coseg train` wrote: its scene, settings and trained Gaussians
    #[arg(long, value_name = "DIR", conflicts_with_all = ["data", "scene", "config"])]
    run: Option<PathBuf>,
    /// Trained Gaussians, a 3DGS PLY file or a run folder, for sections that need no photos
    #[arg(long, value_name = "FILE.ply|RUN")]
    scene: Option<PathBuf>,
    /// Cameras of --scene, as `coseg render` takes them [default: cameras.json beside it]
    #[arg(long, value_name = "FILE.json|DIR", requires = "scene")]
    cameras: Option<PathBuf>,
    /// Measured passes behind each median [default: 5]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=1000))]
    repeats: Option<usize>,
    /// Numbers of Gaussians [default: that of --run or --scene, else 10000,100000]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = RangedU64ValueParser::<usize>::new().range(1..=100_000_000))]
    gaussians: Vec<usize>,
    /// Tiny sizes, a few seconds in all, to see that everything runs
    #[arg(long)]
    quick: bool,
    /// Write the Gaussians and cameras of section `raster` into this folder, for other renderers
    #[arg(long, value_name = "DIR")]
    export: Option<PathBuf>,
    /// Write the figures to this file too
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Where tensors live: wgpu, flex, ndarray or cuda [default: the first in this build, cuda aside]
    #[arg(long, value_name = "NAME")]
    backend: Option<BackendName>,
    #[command(flatten)]
    settings: Settings,
}

impl BenchArgs {
    /// Measures, prints a table for each section, and writes the figures where asked.
    pub fn run(self) -> Result<()> {
        let (backend, device) = device::choose(self.backend)?;
        let machine = Machine::here(device::described(backend));
        let (config, source) = match (&self.run, &self.scene) {
            (Some(dir), _) => {
                let run = RunFolder::existing(dir)?;
                (
                    run.config(&self.settings.sets)?,
                    Source::Trained(run.scene_path()),
                )
            }
            (None, Some(scene)) => {
                let scene = scene_path(scene)?;
                let cameras = cameras_path(self.cameras.as_deref(), &scene)?;
                let source = Source::Files { scene, cameras };
                (self.settings.load(None, None)?, source)
            }
            _ => (
                self.settings.load(self.data.as_ref(), None)?,
                Source::Untrained,
            ),
        };
        terminal::say(&machine.text());
        if self.quick {
            terminal::say("Tiny sizes (--quick): the figures mean nothing.");
        }
        let wanted = |section: &Section| self.only.is_empty() || self.only.contains(section);
        let sections: Vec<Section> = Section::ALL.into_iter().filter(wanted).collect();
        let bar = terminal::bar("bench", sections.len() as u64);
        let subject = Subject::load(&source, &config, self.quick, &device)?;
        let mut gaussians = self.gaussians;
        if gaussians.is_empty() && self.quick {
            gaussians.push(QUICK);
        } else if gaussians.is_empty() && subject.trained {
            gaussians.push(subject.own.len());
        } else if gaussians.is_empty() {
            gaussians.extend(UNTRAINED);
        }
        let effort = if self.quick {
            Effort::quick(self.repeats.unwrap_or(REPEATS[1]), gaussians)
        } else {
            Effort::full(self.repeats.unwrap_or(REPEATS[0]), gaussians)
        };
        if let Some(dir) = &self.export {
            for path in subject.export(dir, &effort)? {
                terminal::say(&format!("exported: {}", path.display()));
            }
        }
        let bench = Bench {
            config,
            subject,
            device,
            effort,
        };
        let mut found = Vec::new();
        for section in sections {
            bar.set_message(section.key());
            bar.tick();
            let findings = bench.measure(section)?;
            terminal::say("");
            terminal::say(findings.text().trim_end());
            bar.inc(1);
            found.push(findings);
        }
        bar.finish_and_clear();
        match &self.json {
            Some(path) => write_json(path, &machine, &bench, &found),
            None => Ok(()),
        }
    }
}

fn write_json(path: &Path, machine: &Machine, bench: &Bench, found: &[Findings]) -> Result<()> {
    let json = serde_json::json!({
        "machine": machine,
        "subject": bench.subject.description,
        "trained": bench.subject.trained,
        "repeats": bench.effort.repeats,
        "sections": found,
    });
    let text =
        serde_json::to_string_pretty(&json).map_err(|e| Error::io(path, "encode", e.into()))?;
    atomic::write_bytes(path, (text + "\n").as_bytes())?;
    terminal::say(&format!("\nfigures: {}", path.display()));
    Ok(())
}
