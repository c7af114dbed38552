//! `coseg data`: checks or describes a scene folder, or suggests photos to label.

use super::{BackendArgs, Settings, fault_list, terminal};
use clap::builder::RangedU64ValueParser;
use clap::{Args, Subcommand};
use coseg::data::{self, Info, LoadOptions};
use coseg::error::{Result, ensure};
use coseg::files::{extension, own};
use coseg::pipeline::{compare_with_photos, suggest};
use coseg::report::pictures;
use coseg::report::sheet::contact_sheet;
use coseg::runs::{read_scene, scene_path};
use std::path::{Path, PathBuf};

/// Pictures on a contact sheet, at most, and pixels across each.
const SHEET: (usize, u32) = (25, 200);

const HELP: &str = "\
Layouts: transforms.json of nerfstudio, instant-ngp and Blender, COLMAP models, Replica as NICE-SLAM and Semantic-NeRF ship it,
ScanNet exports. The files in the folder decide, or --set data.layout=NAME.

Examples:
  coseg data check scenes/living
  coseg data info scenes/living --sheet living.png
  coseg data info scans/scene0000_00 --set data.stride=20 --json
  coseg data suggest scenes/living --count 6";

const SUGGEST_HELP: &str = "\
Each photo is the one that adds most to those before it. With --scene, the photos are to show its Gaussians. Without
it, they are to show the initial points, taken as opaque and as large as their distances. A scene without points gets some
where its photos agree. Only training photos are named: nothing learns from held-out ones. A share of the scene is a share
of the pixels of all training photos.

Examples:
  coseg data suggest scenes/living --count 6              # label these in LabelMe, see docs/from-photos.md
  coseg train --data scenes/living --set data.raw_labels=FOLDER";

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
    /// Name the photos that together show most of the scene, to label these by hand
    Suggest(SuggestArgs),
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

#[derive(Args, Debug)]
#[command(after_help = SUGGEST_HELP)]
struct SuggestArgs {
    /// Scene folder
    #[arg(value_name = "DIR", required_unless_present = "data")]
    dir: Option<PathBuf>,
    /// Scene folder, as `coseg train` takes it
    #[arg(long, value_name = "DIR", conflicts_with = "dir")]
    data: Option<PathBuf>,
    /// Number of photos
    #[arg(long, default_value_t = 6, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    count: usize,
    /// Scene whose Gaussians to show: a PLY, .spz, .sog or .splat file, or its folder
    #[arg(long, value_name = "FILE|DIR")]
    scene: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    settings: Settings,
}

impl DataArgs {
    /// Runs the action.
    pub fn run(self) -> Result<()> {
        match self.action {
            Action::Check(args) => args.run(),
            Action::Info(args) => args.run(),
            Action::Suggest(args) => args.run(),
        }
    }
}

impl CheckArgs {
    fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.dir))?;
        check(&self.dir, &LoadOptions::from(&config), self.all)
    }
}

/// Prints every problem of the scene folder `dir`, or the first few of each kind. An error when there is one.
pub fn check(dir: &Path, options: &LoadOptions, all: bool) -> Result<()> {
    let checked = data::check(dir, options);
    for notice in &checked.notices {
        terminal::note(&format!("note: {notice}"));
    }
    fault_list::print(&checked.problems, all);
    let layout = checked
        .layout
        .map_or("unknown".to_owned(), |layout| layout.to_string());
    let field = format!("layout {layout}, {} frames", checked.frames);
    let count = match checked.problems.len() {
        0 => "no problems".to_owned(),
        1 => "1 problem".to_owned(),
        n => format!("{n} problems"),
    };
    ensure!(checked.problems.is_empty(), dir, "{field}"; found "{count}"; expected "none";
        help "correct the problems above and check again");
    terminal::say(&format!("{}: {field}, {count}", dir.display()));
    Ok(())
}

impl InfoArgs {
    fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.dir))?;
        let options = LoadOptions::from(&config);
        if let Some(path) = &self.sheet {
            ensure!(extension(path) == "png", argument "--sheet"; found "{}", path.display();
                expected "a .png file"; help "end the name in .png");
            data::check_output_file("--sheet", path, (&self.dir, &options))?;
            own::check_argument("--sheet", path)?;
        }
        let info = data::info(&self.dir, &options)?;
        if let Some(path) = &self.sheet {
            let (tiles, classes) = data::thumbnails(&self.dir, &options, SHEET.0, SHEET.1)?;
            pictures::write(path, &contact_sheet(&tiles, &classes))?;
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

impl SuggestArgs {
    fn run(self) -> Result<()> {
        let dir = self.dir.or(self.data).unwrap_or_default();
        let config = self.settings.load(Some(&dir))?;
        let mut scene = data::load(&dir, &LoadOptions::from(&config))?;
        let path = self.scene.as_deref().map(scene_path).transpose()?;
        let ply = path.as_deref().map(read_scene).transpose()?;
        if let (Some(path), Some(ply)) = (&path, &ply) {
            scene = scene.with_origin(ply.origin);
            let device = self.backend.open()?;
            compare_with_photos(path, &ply.gaussians, &scene, &config, &device)?;
        }
        let gaussians = ply.as_ref().map(|ply| &ply.gaussians);
        terminal::note("comparing what the training photos show");
        let suggestions = suggest(&scene, gaussians, self.count, &config)?;
        if self.json {
            terminal::say(&serde_json::json!(suggestions).to_string());
            return Ok(());
        }
        let longest = suggestions.iter().map(|s| s.photo.chars().count()).max();
        let width = longest.unwrap_or(0).max(5);
        terminal::say(&format!("{:<width$}   adds  together", "photo"));
        for s in &suggestions {
            let adds = 100.0 * s.adds;
            let together = 100.0 * s.together;
            terminal::say(&format!(
                "{:<width$}  {adds:>4.1}%     {together:>4.1}%",
                s.photo
            ));
        }
        if suggestions.len() < self.count {
            terminal::note("note: no other photo shows more");
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
        let distorted = format!("{} photos, undistorted on loading", info.distorted);
        say("distorted", distorted);
    }
    if info.masked > 0 {
        let left_out = 100.0 * info.left_out;
        let masks = format!(
            "{} views, {left_out:.2} % of all pixels left out",
            info.masked
        );
        say("masks", masks);
    }
    let c = &info.cameras;
    let [low, high, mean] = [c.low, c.high, c.mean].map(|v| v.map(|v| format!("{v:.3}")).join(" "));
    let cameras = format!("{low} to {high}, extent {:.3} about {mean}", c.extent);
    say("cameras", cameras);
    say("points", info.points.to_string());
    let labels = format!(
        "{} views true, {} views raw",
        info.labelled, info.raw_labelled
    );
    say("labels", labels);
    if info.segments > 0 {
        let segments = format!(
            "{} in the raw labels, {:.2} % of their pixels, to be joined over Gaussians",
            info.segments,
            100.0 * info.in_segments
        );
        say("segments", segments);
    }
    if info.instances > 0 {
        say("instances", format!("{} views true", info.instances));
    }
    print_classes(info);
    for notice in &info.notices {
        say("note", notice.clone());
    }
}

/// Prints how much of the label maps each class covers.
fn print_classes(info: &Info) {
    if !info.classes.is_empty() {
        terminal::say(&format!(
            "{:>14}  {:>7} {:>7} {:>6}  class",
            "id", "true", "raw", "views"
        ));
    }
    // Segments that name no class say nothing of the share of any. The last line is of unlabelled pixels.
    let named = info
        .classes
        .split_last()
        .map_or(&[][..], |(_, named)| named);
    let are_classless = info.segments > 0 && named.iter().all(|class| class.raw == 0.0);
    let share = |is_known: bool, share: f64| {
        let percent = format!("{:.2}%", 100.0 * share);
        if is_known { percent } else { "-".to_owned() }
    };
    for (i, class) in info.classes.iter().enumerate() {
        let truth = share(info.labelled > 0, class.truth);
        let is_unknown = info.raw_labelled == 0 || are_classless && i < named.len();
        let raw = share(!is_unknown, class.raw);
        terminal::say(&format!(
            "{:>14}  {truth:>7} {raw:>7} {:>6}  {}",
            class.id, class.views, class.name
        ));
    }
}
