//! `coseg compare`: a table of variants on the same Gaussians, from a plan.

use super::progress::Bars;
use super::train::command_line;
use super::{BackendArgs, interrupt, terminal};
use clap::Args;
use coseg::compare::{Options, Plan, Tables, run};
use coseg::error::Result;
use coseg::files::{absolute, own, shell_word};
use coseg::runs::scene_path;
use std::path::PathBuf;
use std::process::ExitCode;

/// The last commit that changed what this program was built from.
const COMMIT: &str = env!("COSEG_COMMIT");

const HELP: &str = "\
A plan is a TOML file; docs/compare.md describes it, and configs/tables holds those of this crate.

For each scene, stage one is trained once, into DIR/scenes. For each kind of labels, row and seed, stage two is trained on these
Gaussians. A cell is stored as soon as it is done, and the next command keeps it: a table can be made in many sittings. Cells with
other settings, data or Gaussians, or of another commit of this program, are refused.

DIR gets
  table.md       the tables, with means and spreads over the seeds
  compare.json   the same figures and all cells, for programs
  *.svg          mIoU against frames a second and against seconds, and the IoU of each class
  cells/         one file a cell; delete one to train it again

Examples:
  coseg compare configs/tables/table1.toml --data-root scenes --out runs/table1
  coseg compare configs/tables/table1.toml --data-root scenes --out runs/table1 --only kitchen/corr/
  coseg compare configs/tables/table1.toml --data-root scenes --out runs/table1 --gaussians studio=runs/studio";

/// Arguments of `coseg compare`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct CompareArgs {
    /// Plan of the table
    #[arg(value_name = "PLAN.toml")]
    plan: PathBuf,
    /// Folder to write to; made if absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder that holds the scenes of the plan [default: that of the plan]
    #[arg(long, value_name = "DIR")]
    data_root: Option<PathBuf>,
    /// Take the Gaussians of this file or run as stage one of a scene; may be repeated
    #[arg(long, value_name = "SCENE=FILE.ply|RUN", value_parser = scene_and_file)]
    gaussians: Vec<(String, PathBuf)>,
    /// Run only cells whose name, scene/labels/row/seed, contains this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Commit of this program, for the tables [default: as git said when it was built]
    #[arg(long, value_name = "TEXT")]
    commit: Option<String>,
    /// Keep finished cells of other commits
    #[arg(long)]
    keep_cells: bool,
    #[command(flatten)]
    backend: BackendArgs,
}

fn scene_and_file(text: &str) -> std::result::Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((scene, file)) if !scene.is_empty() && !file.is_empty() => {
            Ok((scene.to_owned(), file.into()))
        }
        _ => Err("expected a scene and a file, for instance studio=runs/studio".into()),
    }
}

impl CompareArgs {
    /// Runs missing cells and writes the tables of all that are finished.
    pub fn run(self) -> Result<ExitCode> {
        let plan = Plan::read(&self.plan, self.data_root.as_deref())?;
        let out = absolute(&self.out)?;
        let files = self.gaussians.iter();
        let files = files.map(|(scene, path)| Ok((scene.clone(), scene_path(path)?)));
        let gaussians = files.collect::<Result<_>>()?;
        for name in Tables::FILES {
            own::check(out.join(name))?;
        }
        let (device_text, device) = self.backend.choose_with_threads()?;
        let options = Options {
            out: out.clone(),
            command: command_line(),
            commit: self.commit.unwrap_or_else(|| COMMIT.to_owned()),
            device: device_text,
            keep_cells: self.keep_cells,
            only: self.only,
            gaussians,
        };
        let cells = plan.cells().len();
        terminal::note(&format!(
            "{}: {cells} cells ({})",
            plan.title, options.device
        ));
        interrupt::watch(interrupt::CHECKPOINT);
        let finished = run(&plan, &options, &device, &mut Bars::default())?;
        let tables = Tables::new(&plan, &finished.cells, &options.command);
        for file in tables.write(&out)? {
            terminal::say(&format!("wrote {}", file.display()));
        }
        let empty = cells - finished.cells.len();
        terminal::say(&format!("{empty} of {cells} cells are empty"));
        if finished.stopped {
            let folder = shell_word(&self.out);
            let how = format!("the same command with --out {folder} continues");
            return Ok(interrupt::stopped(&how));
        }
        Ok(ExitCode::SUCCESS)
    }
}
