//! The `coseg` command line.

mod commands;

use clap::Parser;
use std::process::ExitCode;

/// Tensors of a step are allocated and freed again: this allocator keeps their pages, glibc gives them back.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    commands::terminal::report_panics();
    let cli = commands::Cli::parse();
    commands::terminal::show_warnings(cli.verbose);
    match cli.command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            commands::terminal::error(&error);
            ExitCode::FAILURE
        }
    }
}
