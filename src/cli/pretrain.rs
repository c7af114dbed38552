//! `coseg pretrain`: the point encoder, trained on procedural rooms.

use super::{BackendArgs, terminal};
use clap::Args;
use coseg::data::atomic;
use coseg::error::Result;
use coseg::segmentation::pretrain::{PretrainOptions, PretrainProgress, pretrain};
use std::path::PathBuf;

const HELP: &str = "\
Trains the RandLA encoder to tell the classes of procedural furnished rooms. Its decoder is not kept. The built-in room
of `coseg train` is never among the rooms. The same seed gives the same file on one kind of processor and one backend.
Use the file with --set spatial.source.pretrained=FILE.

Example:
  coseg pretrain --out encoder.safetensors";

/// Arguments of `coseg pretrain`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct PretrainArgs {
    /// File to write
    #[arg(long, value_name = "FILE.safetensors")]
    out: PathBuf,
    /// Optimiser steps, one room each [default: 600]
    #[arg(long, value_name = "N")]
    steps: Option<usize>,
    /// Rooms to train on [default: 96]
    #[arg(long, value_name = "N")]
    rooms: Option<usize>,
    /// Seed of weights, rooms and every other choice
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    backend: BackendArgs,
}

impl PretrainArgs {
    /// Trains and writes the encoder.
    pub fn run(self) -> Result<()> {
        let defaults = PretrainOptions::default();
        let options = PretrainOptions {
            seed: self.seed,
            rooms: self.rooms.unwrap_or(defaults.rooms),
            steps: self.steps.unwrap_or(defaults.steps),
            ..defaults
        };
        let device = self.backend.open()?;
        let all_rooms = options.rooms + options.held_out;
        let bar = terminal::bar("pretrain", (all_rooms + options.steps) as u64);
        let tenth = options.steps.div_ceil(10).max(1);
        let mut show = |at: &PretrainProgress| {
            bar.set_position((at.rooms[0] + at.steps[0]) as u64);
            match at.steps[0] {
                0 => bar.set_message("making rooms"),
                step => {
                    bar.set_message(format!("loss {:.4}", at.loss));
                    if !terminal::draws_bars() && (step % tenth == 0 || step == at.steps[1]) {
                        terminal::note(&format!(
                            "pretrain {step}/{}  loss {:.4}",
                            at.steps[1], at.loss
                        ));
                    }
                }
            }
        };
        let trained = pretrain(&options, &device, &mut show)?;
        bar.finish_and_clear();
        atomic::write_bytes(&self.out, &trained.weights.to_safetensors()?)?;
        terminal::say(&format!(
            "{}: {} held-out rooms, mIoU {:.4}, accuracy {:.4}",
            self.out.display(),
            options.held_out,
            trained.held_out.miou,
            trained.held_out.accuracy
        ));
        Ok(())
    }
}
