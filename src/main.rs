//! The `coseg` command line.

mod cli;

use clap::{CommandFactory, FromArgMatches};
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::allocator::keep_freed_memory();
    cli::terminal::report_panics();
    cli::quiet::silence_drivers();
    let matches = cli::Cli::command().get_matches();
    let name = matches.subcommand_name().unwrap_or_default();
    let cli = cli::Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    cli::terminal::show_warnings(cli.verbose);
    cli::announce(&matches);
    match cli
        .command
        .run(name)
        .and_then(|code| cli::terminal::finish().map(|()| code))
    {
        Ok(code) => code,
        Err(error) => {
            cli::terminal::error(&error);
            ExitCode::FAILURE
        }
    }
}
