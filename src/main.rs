//! The `coseg` command line.

mod commands;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    commands::allocator::keep_freed_memory();
    commands::terminal::report_panics();
    let cli = commands::Cli::parse();
    commands::terminal::show_warnings(cli.verbose);
    match cli.command.run() {
        Ok(code) => code,
        Err(error) => {
            commands::terminal::error(&error);
            ExitCode::FAILURE
        }
    }
}
