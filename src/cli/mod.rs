//! Subcommands: each parses its arguments, calls the library and prints the result.

pub mod allocator;
mod annotations;
mod associate;
mod bench;
mod compare;
mod completions;
mod data;
mod edit;
mod eval;
mod export;
mod fault_list;
mod film;
mod frame_files;
mod from_photos;
mod held_out;
mod interrupt;
mod label;
mod labelled;
mod merge;
mod object_scene;
mod objects;
mod program;
mod progress;
mod prune;
mod query;
pub mod quiet;
mod render;
mod render_path;
mod select;
mod separate;
mod splat_transform;
mod split;
pub mod terminal;
mod train;
mod values;
mod view;
mod vote;

use burn::tensor::Device;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{ArgMatches, Args, CommandFactory, Parser, Subcommand};
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::config::Config;
use coseg::error::{Error, Result};
use coseg::files::own;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::LazyLock;

/// Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.
#[derive(Debug, Parser)]
#[command(name = "coseg", version = version(), propagate_version = true, after_help = EXAMPLES)]
pub struct Cli {
    /// Print what the program is doing
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
        let compiled = BackendName::compiled().iter().copied().chain(cuda);
        let names: Vec<String> = compiled.map(|b| b.to_string()).collect();
        format!("{} ({})", env!("CARGO_PKG_VERSION"), names.join(", "))
    });
    &VERSION
}

const EXAMPLES: &str = "\
Examples:
  coseg train                                  the built-in room, both stages, into runs/builtin
  coseg train --data scenes/living --out runs/living
  coseg label --data scenes/living --model segmenter.onnx --out labels/living
  coseg from-photos photos --out scenes/living a scene folder from photos without poses, or a video
  coseg data check scenes/living               all problems of a folder at once
  coseg train --resume runs/living             continue a run that was stopped
  coseg eval runs/living                       its scores on the held-out views
  coseg render --scene runs/living --out pictures --labels
  coseg render --scene runs/living --out orbit --path orbit
  coseg view --scene runs/living               a page to walk through it in a browser
  coseg vote --scene scene.ply --data scenes/living --out runs/voted
  coseg associate --scene scene.ply --data scenes/living --out runs/objects --set data.raw_labels=segments
  coseg objects --scene runs/living            its objects, and where they are
  coseg select --scene runs/living --frame test_001 --pixel 240,180 --name lamp --out named
  coseg query --scene runs/living --features lseg --weights clip.safetensors --text \"a red chair\" --out found
  coseg separate --scene runs/living --out objects/scene.ply    each chair an object of its own
  coseg edit --scene runs/living --out without.ply --remove sofa
  coseg export --scene runs/living --out living.spz
  coseg prune --scene runs/living --data scenes/living --out small --within 0.1
  coseg split --data scenes/house --blocks 3x2 blocks of a scene that is larger than a machine
  coseg merge --out runs/house runs/?_?        one scene from their runs
  coseg bench --run runs/living                speed on this machine
  coseg compare configs/tables/table1.toml --data-root scenes --out runs/table1

No command writes over files that it did not write, except `train --resume` in its run, and `edit`, `select`, `query`,
`separate` and `export` with --force.
Exit code: 0 success, 1 an error that says what to do, 2 an invalid option or setting, 130 stopped by Ctrl-C.";

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Turn photos and raw label maps into a segmented Gaussian scene
    Train(train::TrainArgs),
    /// Label photos with a 2D segmenter: label maps, scores, classes
    Label(label::LabelArgs),
    /// Make a scene folder from photos or a video: finds the poses
    FromPhotos(from_photos::FromPhotosArgs),
    /// Check a scene folder, or describe it
    Data(data::DataArgs),
    /// Score a run on held-out views
    Eval(eval::EvalArgs),
    /// Render a scene in colour and labels
    Render(render::RenderArgs),
    /// Write a scene as a page for the browser
    View(view::ViewArgs),
    /// Label the Gaussians of a scene by a vote of raw label maps, without training
    Vote(vote::VoteArgs),
    /// Give the segments of an object one id in all views, through the Gaussians that they cover
    Associate(associate::AssociateArgs),
    /// List the objects of a labelled scene, or find the one at a pixel
    Objects(objects::ObjectsArgs),
    /// Make an object of the thing that a few pixels show, with or without labels
    Select(select::SelectArgs),
    /// Find what a text describes in a scene, by feature maps of CLIP; makes an object of it
    Query(query::QueryArgs),
    /// Split a label into objects that do not touch
    Separate(separate::SeparateArgs),
    /// Keep, remove, turn, move and paint objects of a labelled scene, or apply edits of the viewer
    Edit(edit::EditArgs),
    /// Write a scene, or each of its objects, as files of other formats
    Export(export::ExportArgs),
    /// Leave out the Gaussians that the photos of a scene do not need
    Prune(prune::PruneArgs),
    /// Split a scene into overlapping blocks that are trained one by one
    Split(split::SplitArgs),
    /// Merge the trained blocks of a scene
    Merge(merge::MergeArgs),
    /// Measure speed, error and memory on this machine
    Bench(bench::BenchArgs),
    /// Make a table of variants on the same Gaussians, from a plan
    Compare(compare::CompareArgs),
    /// Print a script that completes commands and options in a shell
    Completions(completions::CompletionsArgs),
}

impl Command {
    /// Runs the command, which is called `name`. A run that was stopped is neither an error nor a success.
    pub fn run(self, name: &str) -> Result<ExitCode> {
        // Commands whose files this one may overwrite.
        let others: &[&str] = match self {
            Self::Label(_) => &["train", "from-photos"],
            Self::FromPhotos(_) => &["label"],
            Self::View(_) => &["train"],
            _ => &[],
        };
        own::guard(&[&[name], others].concat());
        let succeeds = |()| ExitCode::SUCCESS;
        let done = match self {
            Self::Train(args) => args.run(),
            Self::Compare(args) => args.run(),
            Self::Label(args) => args.run().map(succeeds),
            Self::FromPhotos(args) => args.run().map(succeeds),
            Self::Data(args) => args.run().map(succeeds),
            Self::Eval(args) => args.run().map(succeeds),
            Self::Render(args) => args.run().map(succeeds),
            Self::View(args) => args.run().map(succeeds),
            Self::Vote(args) => args.run().map(succeeds),
            Self::Associate(args) => args.run().map(succeeds),
            Self::Objects(args) => args.run().map(succeeds),
            Self::Select(args) => args.run().map(succeeds),
            Self::Query(args) => args.run().map(succeeds),
            Self::Separate(args) => args.run().map(succeeds),
            Self::Edit(args) => args.run().map(succeeds),
            Self::Export(args) => args.run().map(succeeds),
            Self::Prune(args) => args.run().map(succeeds),
            Self::Split(args) => args.run().map(succeeds),
            Self::Merge(args) => args.run().map(succeeds),
            Self::Bench(args) => args.run().map(succeeds),
            Self::Completions(args) => args.run().map(succeeds),
        };
        match done {
            Err(Error::Stopped) => Ok(interrupt::stopped("the same command continues")),
            done => done,
        }
    }
}

/// The arguments of this program. Without options that fit, this ends it.
pub fn arguments() -> ArgMatches {
    Cli::command()
        .try_get_matches()
        .unwrap_or_else(|mut error| {
            let is_folder = match error.get(ContextKind::InvalidArg) {
                Some(ContextValue::String(word)) => Path::new(word).is_dir(),
                _ => false,
            };
            if error.kind() == ErrorKind::UnknownArgument && is_folder {
                let tip = "'--data DIR' names a scene folder, '--scene DIR' a run".into();
                error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
            }
            error.exit()
        })
}

/// Arguments that name what a command reads.
const INPUTS: [&str; 11] = [
    "resume",
    "scene",
    "run",
    "runs",
    "plan",
    "source",
    "dir",
    "data",
    "model",
    "segmenter",
    "config",
];

/// Number of inputs that the message names, at most.
const NAMED: usize = 3;

/// Prints what the command is about to read: that may take long, and progress bars are drawn on terminals only.
pub fn announce(matches: &ArgMatches) {
    let mut action = matches;
    while let Some((_, inner)) = action.subcommand() {
        action = inner;
    }
    let values = |name: &&str| action.try_get_raw(name).ok().flatten();
    let inputs = INPUTS.iter().filter_map(values).flatten();
    let inputs: Vec<_> = inputs.map(|input| input.to_string_lossy()).collect();
    match matches.subcommand_name() {
        Some("completions") => {}
        _ if inputs.is_empty() => terminal::note("reading the settings"),
        _ => {
            let first = inputs[..inputs.len().min(NAMED)].join(", ");
            let more = match inputs.len().saturating_sub(NAMED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            terminal::note(&format!("reading {first}{more}"));
        }
    }
}

/// Where to compute, for several commands.
#[derive(Args, Debug)]
pub struct BackendArgs {
    /// Where to compute: wgpu, flex, ndarray or cuda [default: the first that works, never cuda]
    #[arg(long, value_name = "NAME")]
    pub backend: Option<BackendName>,
}

impl BackendArgs {
    /// Opens the device.
    pub fn open(&self) -> Result<Device> {
        device::open(self.backend)
    }

    /// Opens the device, and describes it in a few words.
    pub fn choose(&self) -> Result<(String, Device)> {
        let (backend, device) = device::choose(self.backend)?;
        Ok((device::described(backend), device))
    }

    /// The same, with the processor threads.
    pub fn choose_with_threads(&self) -> Result<(String, Device)> {
        let (backend, device) = self.choose()?;
        let threads = rayon::current_num_threads();
        Ok((format!("{backend} backend, {threads} threads"), device))
    }
}

/// Settings, for several commands.
#[derive(Args, Clone, Debug)]
pub struct Settings {
    /// Settings file (TOML); see configs/ for examples
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a setting, for instance segmentation.lr=6e-3; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
}

impl Settings {
    /// The checked settings; `data` overrides the others. Without a scene folder those of the built-in room.
    pub fn load(&self, data: Option<&PathBuf>) -> Result<Config> {
        let data = data.map(PathBuf::as_path);
        or_usage_error(Config::load_for(data, self.config.as_deref(), &self.sets))
    }
}

/// Ends the program as clap does where a setting, or a `--set`, is wrong: it was given on the command line.
pub fn or_usage_error<T>(read: Result<T>) -> Result<T> {
    let is_usage = |error: &Error| match error {
        Error::Config { .. } => true,
        Error::Argument { name, .. } => name == "--set",
        _ => false,
    };
    if let Some(error) = read.as_ref().err().filter(|error| is_usage(error)) {
        let message = format!("{}\n", terminal::escaped(&error.to_string()));
        clap::Error::raw(ErrorKind::ValueValidation, message).exit();
    }
    read
}
