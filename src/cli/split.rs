//! `coseg split`: a scene as overlapping blocks that are trained one by one.

use super::values::numbers;
use super::{Settings, terminal};
use clap::Args;
use coseg::data::blocks::{BLOCK, PlannedBlock, split};
use coseg::data::{self, LoadOptions, check_outputs};
use coseg::error::{Result, ensure};
use coseg::files::{names, own};
use std::path::{Path, PathBuf};

const HELP: &str = "\
Each block is a folder with one small file, block.json, which `coseg train --data` reads as a scene: the photos of the block,
and its part of the initial cloud. Nothing is copied: the scene folder must stay where it is. A block has a core, which is its
own, and a margin of a fifth of its size on each side. It has the photos taken there, and those of which a quarter shows its
core. Borders are placed so that about equally many training cameras stand in each block. `coseg merge` puts the trained blocks
together. docs/scale.md has more.

Examples:
  coseg split --data scenes/house --blocks 3x2 --out blocks
  coseg train --data blocks/0_0 --out runs/0_0      # and so on: split prints a line for each block
  coseg merge --out runs/house runs/*_*";

/// Arguments of `coseg split`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct SplitArgs {
    /// Scene folder
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Columns and rows of blocks, along two horizontal axes
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = counts)]
    blocks: [usize; 2],
    /// Folder for the folders of the blocks; made if absent
    #[arg(long, value_name = "DIR", default_value = "blocks")]
    out: PathBuf,
    #[command(flatten)]
    settings: Settings,
}

fn counts(text: &str) -> std::result::Result<[usize; 2], String> {
    numbers(text, 'x').ok_or_else(|| "expected columns and rows, for instance 3x2".into())
}

impl SplitArgs {
    /// Plans and writes the blocks.
    pub fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.data))?;
        let options = LoadOptions::from(&config);
        data::locate(&self.data, &options)?;
        check_outputs("--out", &[&self.out], Some((&self.data, &options)))?;
        let planned = split(&self.data, &options, self.blocks)?;
        self.check_folders(&planned)?;
        for PlannedBlock { block, points } in &planned {
            let folder = self.out.join(block.name());
            block.write(&folder)?;
            let run = Path::new("runs").join(block.name());
            terminal::say(&format!(
                "{}: {} training and {} held-out cameras, {points} points; coseg train --data {} --out {}",
                block.name(),
                block.train.len(),
                block.test.len(),
                folder.display(),
                run.display(),
            ));
        }
        Ok(())
    }

    /// Refuses to write over files of others, and to mix with the blocks of another split.
    fn check_folders(&self, planned: &[PlannedBlock]) -> Result<()> {
        let wanted: Vec<String> = planned.iter().map(|planned| planned.block.name()).collect();
        let others = names(&self.out, |name, path| {
            path.join(BLOCK).exists() && !wanted.iter().any(|wanted| wanted == name)
        });
        ensure!(others.is_empty(), argument "--out"; found "{}, which has a block {} of another split", self.out.display(), others[0];
            expected "a new folder, or one of the same number of blocks"; help "name a new folder");
        for name in &wanted {
            let folder = self.out.join(name);
            own::check(folder.join(BLOCK))?;
            if !folder.join(BLOCK).exists() {
                check_outputs("--out", &[&folder], None)?;
            }
        }
        Ok(())
    }
}
