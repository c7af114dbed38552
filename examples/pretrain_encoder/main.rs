//! Trains the RandLA encoder to tell the classes of procedural furnished rooms. Its decoder is thrown away. The built-in room of
//! `coseg train` is never among the rooms. The same seed gives the same file on one kind of processor and one backend.
//!
//!     cargo run --release --example pretrain_encoder -- --out encoder.safetensors
//!     cargo run --release -- train --set spatial.source.pretrained=encoder.safetensors

mod rooms;
mod training;

use clap::Parser;
use coseg::backend::device::{self, BackendName};
use coseg::error::Result;
use coseg::files::atomic;
use std::path::PathBuf;
use training::{PretrainOptions, pretrain};

#[derive(Parser)]
struct Args {
    /// File to write
    #[arg(long, value_name = "FILE.safetensors")]
    out: PathBuf,
    /// Optimiser steps, one room each
    #[arg(long, value_name = "N", default_value_t = PretrainOptions::default().steps)]
    steps: usize,
    /// Rooms to train on
    #[arg(long, value_name = "N", default_value_t = PretrainOptions::default().rooms)]
    rooms: usize,
    /// Seed of weights, rooms and every other choice
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Where to compute: wgpu, flex or ndarray [default: the first that works]
    #[arg(long, value_name = "NAME")]
    backend: Option<BackendName>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let options = PretrainOptions {
        seed: args.seed,
        rooms: args.rooms,
        steps: args.steps,
        ..PretrainOptions::default()
    };
    let tenth = options.steps.div_ceil(10).max(1);
    let mut show = |step: usize, loss: f32| {
        if step.is_multiple_of(tenth) {
            eprintln!("{step}/{}  loss {loss:.4}", options.steps);
        }
    };
    let trained = pretrain(&options, &device::open(args.backend)?, &mut show)?;
    atomic::write_bytes(&args.out, &trained.weights.to_safetensors()?)?;
    println!("mean loss of each tenth: {:.3?}", trained.curve);
    println!(
        "{}: {} held-out rooms, mIoU {:.4}, accuracy {:.4}",
        args.out.display(),
        options.held_out,
        trained.held_out.miou,
        trained.held_out.accuracy
    );
    Ok(())
}
