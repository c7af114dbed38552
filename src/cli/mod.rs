//! Subcommands: each parses its arguments, calls the library, and says what came out.

pub mod allocator;
mod associate;
mod bench;
mod data;
mod edit;
mod eval;
mod faults;
mod interrupt;
mod labelled;
mod object_scene;
mod objects;
mod pretrain;
mod progress;
mod render;
mod render_path;
mod run_folder;
mod scene_file;
mod separate;
pub mod terminal;
mod train;
mod view;
mod vote;

use clap::{Args, Parser, Subcommand};
use coseg::backend::device::BackendName;
use coseg::config::Config;
use coseg::error::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::LazyLock;

/// Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.
#[derive(Debug, Parser)]
#[command(name = "coseg", version = version(), propagate_version = true, after_help = EXAMPLES)]
pub struct Cli {
    /// Say more about what is going on
    #[arg(long, short, global = true, display_order = 900)]
    pub verbose: bool,
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

/// The version, and which backends are in this build, best first.
fn version() -> &'static str {
    static VERSION: LazyLock<String> = LazyLock::new(|| {
        let cuda = cfg!(feature = "cuda").then_some(BackendName::Cuda);
        let names: Vec<String> = BackendName::compiled()
            .iter()
            .copied()
            .chain(cuda)
            .map(|b| b.to_string())
            .collect();
        format!("{} ({})", env!("CARGO_PKG_VERSION"), names.join(", "))
    });
    &VERSION
}

const EXAMPLES: &str = "\
Examples:
  coseg train                                  the built-in room, both stages, into runs/builtin
  coseg train --data scenes/living --out runs/living
  coseg data check scenes/living               everything that is wrong with a folder, at once
  coseg train --resume runs/living             go on where a run was stopped
  coseg eval runs/living                       its scores on the held-out views
  coseg render --scene runs/living --out pictures --labels
  coseg render --scene runs/living --out orbit --path orbit
  coseg view --scene runs/living               a page to walk through it in a browser
  coseg vote --scene scene.ply --data scenes/living --out runs/voted
  coseg associate --scene scene.ply --data scenes/living --out runs/objects --set data.raw_labels=segments
  coseg objects --scene runs/living            what there is in it, and where
  coseg separate --scene runs/living --out objects/scene.ply    each chair a chair of its own
  coseg edit --scene runs/living --out without.ply --remove sofa
  coseg bench --run runs/living                speed on this machine, beside the bars of the design

Exit code: 0 done, 1 an error that names what to help, 2 a mistake on the command line, 130 stopped by Ctrl-C.";

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Turn photos and raw label maps into a segmented Gaussian scene
    Train(train::TrainArgs),
    /// Look at a scene folder: its problems, what it holds
    Data(data::DataArgs),
    /// Score a run on held-out views
    Eval(eval::EvalArgs),
    /// Render a scene in colour and labels
    Render(render::RenderArgs),
    /// Write a scene as a page to walk through in a browser
    View(view::ViewArgs),
    /// Label the Gaussians of a scene by a vote of raw label maps, without training
    Vote(vote::VoteArgs),
    /// Give segments that show the same thing one id in all views, by way of a scene's Gaussians
    Associate(associate::AssociateArgs),
    /// List the objects of a labelled scene, or say which one a pixel shows
    Objects(objects::ObjectsArgs),
    /// Make things of one label that do not touch objects of their own
    Separate(separate::SeparateArgs),
    /// Keep, remove, turn and move objects of a labelled scene
    Edit(edit::EditArgs),
    /// Train the point encoder on procedural rooms
    Pretrain(pretrain::PretrainArgs),
    /// Measure speed against error on this machine
    Bench(bench::BenchArgs),
}

impl Command {
    /// Runs the command; a run that was stopped is no error, and not done either.
    pub fn run(self) -> Result<ExitCode> {
        let done = match self {
            Self::Train(args) => return args.run(),
            Self::Data(args) => args.run(),
            Self::Eval(args) => args.run(),
            Self::Render(args) => args.run(),
            Self::View(args) => args.run(),
            Self::Vote(args) => args.run(),
            Self::Associate(args) => args.run(),
            Self::Objects(args) => args.run(),
            Self::Separate(args) => args.run(),
            Self::Edit(args) => args.run(),
            Self::Pretrain(args) => args.run(),
            Self::Bench(args) => args.run(),
        };
        done.map(|()| ExitCode::SUCCESS)
    }
}

/// Settings as several commands take them.
#[derive(Args, Debug)]
pub struct Settings {
    /// Settings file (TOML); see configs/ for examples
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting, for instance segmentation.lr=6e-3; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

impl Settings {
    /// The checked settings, with `--data` and `--seed` as the last words; without a scene folder those of the built-in scene.
    pub fn load(&self, data: Option<&PathBuf>, seed: Option<u64>) -> Result<Config> {
        let mut config = Config::load_for(
            data.map(PathBuf::as_path),
            self.config.as_deref(),
            &self.sets,
        )?;
        if let Some(seed) = seed {
            config.seed = seed;
        }
        config.validate()?;
        Ok(config)
    }
}
