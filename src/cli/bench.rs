//! `coseg bench`: speed against error on this machine.

use super::run_folder::RunFolder;
use super::scene_file::{cameras_path, scene_path};
use super::{Settings, terminal};
use clap::Args;
use clap::builder::RangedU64ValueParser;
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::bench::{Bench, Effort, Findings, LARGE_BYTES, Machine, Section, Source, Subject};
use coseg::data::atomic;
use coseg::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Passes behind a median, and those of --quick.
const REPEATS: [usize; 2] = [5, 1];

const HELP: &str = "\
Sections
  raster        colour at 480x360, forward and with its backward pass, at 10,000, 100,000 and 1,000,000
                Gaussians; cost of a contributing pair, growth, peak memory
  channels      RGB, RGB + 20 classes and 64 channels at 480x360 and 1920x1080 of 100,000 Gaussians (--large:
                a million too), in milliseconds and frames a second
  curve         each setting of the rasterizer moved alone: time, and error against an f64 render with all exact
  building      an iteration of stage one on the scene's own photos, at 15,000 and 50,000 Gaussians
  unprojection  4 x 64 feature channels lifted onto 100,000 Gaussians from 80 views, at both resolutions
  encoding      the point encoder on 100,000 points
  segmentation  an iteration of stage two, where the scene has raw labels
  memory        peak memory and time of such an iteration on 100,000 Gaussians (--large: a million too, in
                about 6 GB), as segmentation.decoder_chunk goes from 4,096 to all at once
  roofline      what the device could do at most (GB/s, GFLOP/s; latencies of a GPU), and how much of it is
                reached on 100,000 Gaussians (--large: a million too): RGB, with 20 classes, 64 channels,
                forward + backward, a view lifted; bytes and operations counted, the longer time is the roof

Every figure is a median with the smallest and largest measurement, after a warm-up run that is not counted. Beside it
stands the bar that the design sets for it, on two cores, and whether it is met; bars that were set for another scene
or size are shown without a verdict. Close other programs first: the first lines say how busy the machine was.

Without --run or --scene nothing is trained, and the output says so: Gaussians are flat discs on the built-in room's
surfaces or, with --data, the points that training would start from. Trained ones are resampled to the number that a
line states: fewer by chance and larger, more as smaller copies, so that each pixel meets about as many as before.

Examples:
  coseg bench                                              some minutes on two cores
  coseg bench --run runs/living --json living.json
  coseg bench --only building --data scenes/fox --set data.transforms=transforms_4.json
  coseg bench --only raster,curve --scene scene.ply --cameras transforms.json";

/// Arguments of `coseg bench`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct BenchArgs {
    /// Sections to measure, with commas between [default: all]
    #[arg(long, value_name = "SECTION,...", value_delimiter = ',')]
    only: Vec<Section>,
    /// Scene folder with photos [default: the built-in room]
    #[arg(long, value_name = "DIR", conflicts_with = "scene")]
    data: Option<PathBuf>,
    /// Folder that `coseg train` wrote: its scene, settings and trained Gaussians
    #[arg(long, value_name = "DIR", conflicts_with_all = ["data", "scene", "config"])]
    run: Option<PathBuf>,
    /// Trained Gaussians in the 3DGS PLY convention or in a run folder, for sections that need no photos
    #[arg(long, value_name = "FILE.ply|RUN")]
    scene: Option<PathBuf>,
    /// Cameras of --scene, as `coseg render` takes them [default: cameras.json beside it]
    #[arg(long, value_name = "FILE.json|DIR", requires = "scene")]
    cameras: Option<PathBuf>,
    /// Measured passes behind each median [default: 5]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=1000))]
    repeats: Option<usize>,
    /// A million Gaussians in `channels`, `memory`, `roofline`; in `raster` with little memory free
    #[arg(long)]
    large: bool,
    /// Tiny sizes, a few seconds in all: shows that everything runs; the figures mean nothing
    #[arg(long, conflicts_with = "large")]
    quick: bool,
    /// Write what `channels` renders into this folder, Gaussians and cameras, for other renderers
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
    /// Measures, prints a table a section, and writes the figures where asked.
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
        let effort = match self.quick {
            true => Effort::quick(self.repeats.unwrap_or(REPEATS[1])),
            false => {
                let fits = machine
                    .available_memory_bytes
                    .is_none_or(|bytes| bytes >= LARGE_BYTES);
                let mut effort =
                    Effort::full(self.repeats.unwrap_or(REPEATS[0]), self.large || fits);
                effort.memory.extend(self.large.then_some(1_000_000));
                effort
            }
        };
        terminal::say(&machine.text());
        if self.quick {
            terminal::say("Tiny sizes (--quick): the figures mean nothing.");
        }
        let wanted = |section: &Section| self.only.is_empty() || self.only.contains(section);
        let sections: Vec<Section> = Section::ALL.into_iter().filter(wanted).collect();
        let bar = terminal::bar("bench", sections.len() as u64);
        let subject = Subject::load(&source, &config, self.quick, &device)?;
        let bench = Bench {
            config,
            subject,
            device,
            effort,
        };
        if let Some(dir) = &self.export {
            let written: Vec<String> = bench
                .export(dir)?
                .iter()
                .map(|path| path.display().to_string())
                .collect();
            terminal::say(&format!("what is rendered: {}", written.join(", ")));
        }
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
        "trained": bench.subject.trained().is_some(),
        "repeats": bench.effort.repeats,
        "sections": found,
    });
    let text =
        serde_json::to_string_pretty(&json).map_err(|e| Error::io(path, "encode", e.into()))?;
    atomic::write_bytes(path, (text + "\n").as_bytes())?;
    terminal::say(&format!("\nfigures: {}", path.display()));
    Ok(())
}
