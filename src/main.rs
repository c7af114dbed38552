//! The `coseg` command line.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::allocator::keep_freed_memory();
    cli::terminal::report_panics();
    let cli = cli::Cli::parse();
    cli::terminal::show_warnings(cli.verbose);
    match cli
        .command
        .run()
        .and_then(|code| cli::terminal::finish().map(|()| code))
    {
        Ok(code) => code,
        Err(error) => {
            cli::terminal::error(&error);
            ExitCode::FAILURE
        }
    }
}
