//! `coseg data`: checks or describes a scene folder.

use super::{Settings, fault_list, terminal};
use clap::{Args, Subcommand};
use coseg::data::{self, Info, LoadOptions, atomic};
use coseg::error::{Error, Result};
use coseg::report::pictures;
use coseg::report::sheet::contact_sheet;
use std::path::PathBuf;

/// Pictures on a contact sheet, at most, and pixels across each.
const SHEET: (usize, u32) = (25, 200);

const HELP: &str = "\
Layouts: transforms.json of nerfstudio and instant-ngp, COLMAP models, Replica as NICE-SLAM and Semantic-NeRF ship it,
ScanNet exports. The files in the folder decide, or --set data.layout=NAME.

Examples:
  coseg data check scenes/living
  coseg data info scenes/living --sheet living.png
  coseg data info scans/scene0000_00 --set data.stride=20 --json";

/// Arguments of `coseg data`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct DataArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List every problem of a scene folder at once; exit code 1 when there is one
    Check(CheckArgs),
    /// Show counts, splits, image sizes, camera extent and classes
    Info(InfoArgs),
}

#[derive(Args, Debug)]
struct CheckArgs {
    /// Scene folder
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Print every problem, not only the first few of each kind
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    settings: Settings,
}

#[derive(Args, Debug)]
struct InfoArgs {
    /// Scene folder
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Write a contact sheet: photos with their labels and a legend
    #[arg(long, value_name = "FILE.png")]
    sheet: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: Settings,
}

impl DataArgs {
    /// Checks or describes the folder.
    pub fn run(self) -> Result<()> {
        match self.action {
            Action::Check(args) => args.run(),
            Action::Info(args) => args.run(),
        }
    }
}

impl CheckArgs {
    fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.dir), None)?;
        let checked = data::check(&self.dir, &LoadOptions::for_training(&config));
        for notice in &checked.notices {
            terminal::note(&format!("note: {notice}"));
        }
        fault_list::print(&checked.problems, self.all);
        let layout = checked.layout.map_or("unknown", |layout| layout.name());
        let field = format!("layout {layout}, {} frames", checked.frames);
        let count = match checked.problems.len() {
            0 => {
                terminal::say(&format!("{}: {field}, no problems", self.dir.display()));
                return Ok(());
            }
            1 => "1 problem".to_owned(),
            n => format!("{n} problems"),
        };
        let help = "correct the problems above and check again";
        Err(Error::input(&self.dir, field, count, "none", help))
    }
}

impl InfoArgs {
    fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.dir), None)?;
        let options = LoadOptions::for_training(&config);
        if let Some(path) = &self.sheet {
            data::check_output_file("--sheet", path, (&self.dir, &options))?;
        }
        let info = data::info(&self.dir, &options)?;
        if let Some(path) = &self.sheet {
            let (tiles, classes) = data::thumbnails(&self.dir, &options, SHEET.0, SHEET.1)?;
            atomic::write_bytes(
                path,
                &pictures::png(&contact_sheet(&tiles, &classes), path)?,
            )?;
        }
        if self.json {
            terminal::say(&serde_json::json!(info).to_string());
            return Ok(());
        }
        print(&info);
        if let Some(path) = &self.sheet {
            terminal::say(&format!("contact sheet: {}", path.display()));
        }
        Ok(())
    }
}

fn print(info: &Info) {
    let say = |name: &str, value: String| terminal::say(&format!("{name:>14}  {value}"));
    terminal::say(&format!("{}: layout {}", info.name, info.layout));
    say("views", format!("{} train, {} test", info.train, info.test));
    for (w, h, n) in &info.sizes {
        say("photos", format!("{n} of {w}x{h} pixels"));
    }
    if info.distorted > 0 {
        say(
            "distorted",
            format!("{} photos, undistorted on loading", info.distorted),
        );
    }
    if info.masked > 0 {
        say(
            "masks",
            format!(
                "{} views, {:.2} % of all pixels left out",
                info.masked,
                100.0 * info.left_out
            ),
        );
    }
    let c = &info.cameras;
    let numbers = |v: [f64; 3]| v.map(|v| format!("{v:.3}")).join(" ");
    say(
        "cameras",
        format!(
            "{} to {}, extent {:.3} about {}",
            numbers(c.low),
            numbers(c.high),
            c.extent,
            numbers(c.mean)
        ),
    );
    say("points", info.points.to_string());
    say(
        "labels",
        format!(
            "{} views true, {} views raw",
            info.labelled, info.raw_labelled
        ),
    );
    if info.segments > 0 {
        say(
            "segments",
            format!(
                "{} in the raw labels, to be joined over Gaussians",
                info.segments
            ),
        );
    }
    if info.instances > 0 {
        say("instances", format!("{} views true", info.instances));
    }
    if !info.classes.is_empty() {
        terminal::say(&format!(
            "{:>14}  {:>7} {:>7} {:>6}  class",
            "id", "true", "raw", "views"
        ));
    }
    for class in &info.classes {
        let (truth, raw) = (100.0 * class.truth, 100.0 * class.raw);
        terminal::say(&format!(
            "{:>14}  {truth:>6.2}% {raw:>6.2}% {:>6}  {}",
            class.id, class.views, class.name
        ));
    }
    for notice in &info.notices {
        say("note", notice.clone());
    }
}
