//! `coseg merge`: the runs of the blocks of a scene as one scene.

use super::terminal;
use clap::Args;
use coseg::error::Result;
use coseg::runs::{Merged, merge};
use std::path::PathBuf;

const HELP: &str = "\
Takes the runs of all blocks of one split, in any order. Keeps the Gaussians of each block whose centres lie in its core.
Labels that are classes stay as they are. Objects that association found in each block get common ids: two of neighbouring
blocks are one if most of their Gaussians lie in the same places where the blocks overlap. Writes scene.ply, classes.json,
cameras.json, identities.safetensors and config.toml, which names the whole scene: `coseg eval` scores it on the held-out views.

Examples:
  coseg merge --out runs/house runs/0_0 runs/1_0 runs/2_0
  coseg eval runs/house";

/// Arguments of `coseg merge`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct MergeArgs {
    /// Folders that `coseg train` wrote, one for each block
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Folder to write to; made if absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl MergeArgs {
    /// Merges and writes.
    pub fn run(self) -> Result<()> {
        Merged::check_output(&self.out)?;
        let merged = merge(&self.runs)?;
        merged.write(&self.out)?;
        for (name, [kept, all]) in &merged.blocks {
            terminal::say(&format!(
                "{name}: {kept} of {all} Gaussians are in the core"
            ));
        }
        let objects = merged.joined.map_or(String::new(), |joined| {
            let objects = merged.classes.len();
            format!(", {objects} objects, {joined} joined across borders")
        });
        terminal::say(&format!(
            "{}: {} Gaussians{objects}",
            self.out.display(),
            merged.gaussians.len()
        ));
        Ok(())
    }
}
