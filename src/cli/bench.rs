//! `coseg bench`: speed against error, times of the stages, memory.

use super::{BackendArgs, Settings, or_usage_error, terminal};
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use coseg::bench::{Bench, Figures, Machine};
use coseg::error::{Error, Result};
use coseg::files::{atomic, own};
use coseg::runs::{RunFolder, SCENE, read_scene};
use std::path::{Path, PathBuf};

const HELP: &str = "\
Sections
  curve   each setting of the rasterizer, the number of Gaussians and the size of the picture changed alone: times of forward
          and backward, and the errors of the picture and of each gradient against exact f64
  stages  a step of stage one, image features and their lifting from all views, a step of stage two where the scene has
          raw labels; the peak memory of each stage

Each figure is a median with the smallest and the largest measurement. Warm-up is not counted. Close other programs first:
the first lines say whether the machine is busy.

Without --run the Gaussians are those that training starts from. With --gaussians the scene is resampled: to fewer and
larger Gaussians, or to more and smaller ones.

Examples:
  coseg bench                                              some minutes on two cores
  coseg bench --run runs/living --json living.json
  coseg bench --run runs/living --gaussians 100000,1000000 --only curve
  coseg bench --only stages --data scenes/fox --set data.transforms=transforms_4.json";

/// Arguments of `coseg bench`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct BenchArgs {
    /// Measure only this section [default: both]
    #[arg(long, value_name = "SECTION")]
    only: Option<Section>,
    /// Scene folder with photos [default: the built-in room]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder that `coseg train` wrote: its scene, settings and trained Gaussians
    #[arg(long, value_name = "RUN", conflicts_with_all = ["data", "config"])]
    run: Option<PathBuf>,
    /// Measured passes behind each median
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = RangedU64ValueParser::<usize>::new().range(1..=1000))]
    repeats: usize,
    /// Numbers of Gaussians, separated by commas [default: that of the scene]
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = RangedU64ValueParser::<usize>::new().range(1..=100_000_000))]
    gaussians: Vec<usize>,
    /// Write the figures to this file too; new, or one that this program wrote
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    settings: Settings,
}

/// A part of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Section {
    Curve,
    Stages,
}

impl BenchArgs {
    /// Measures, prints a table for each section, and writes the figures if asked to.
    pub fn run(mut self) -> Result<()> {
        if let Some(path) = &self.json {
            own::check(path)?;
        }
        let (backend, device) = self.backend.choose()?;
        let machine = Machine::here(backend);
        terminal::say_lines(&machine.text());
        let (config, trained) = match &self.run {
            Some(dir) => {
                let run = RunFolder::existing(dir)?;
                let scene = read_scene(&run.file(SCENE))?;
                let sets = &self.settings.sets;
                (or_usage_error(run.config(sets))?, Some(scene))
            }
            None => (self.settings.load(self.data.as_ref())?, None),
        };
        let bench = Bench::load(config, trained, device, self.repeats)?;
        terminal::say(&bench.subject());
        if self.gaussians.is_empty() {
            self.gaussians.push(bench.gaussians.len());
        }
        let mut found = Vec::new();
        for section in Section::value_variants() {
            if self.only.is_some_and(|only| only != *section) {
                continue;
            }
            for &count in &self.gaussians {
                let measured = match section {
                    Section::Curve => bench.curve(count),
                    Section::Stages => bench.stages(count).map(|figures| vec![figures]),
                };
                match measured {
                    Err(error @ Error::Limit { .. }) => {
                        terminal::note(&format!("{count} Gaussians are left out: {error}"));
                    }
                    measured => {
                        for figures in measured? {
                            terminal::say_lines(&format!("\n{}", figures.text()));
                            found.push(figures);
                        }
                    }
                }
            }
        }
        match &self.json {
            Some(path) => write_json(path, &machine, &bench, &found),
            None => Ok(()),
        }
    }
}

fn write_json(path: &Path, machine: &Machine, bench: &Bench, found: &[Figures]) -> Result<()> {
    let json = serde_json::json!({
        "machine": machine,
        "subject": bench.subject(),
        "trained": bench.trained,
        "repeats": bench.repeats,
        "sections": found,
    });
    atomic::write_json(path, &json)?;
    terminal::say("");
    terminal::say(&format!("figures: {}", path.display()));
    Ok(())
}
