//! The `coseg` command line.

mod cli;

use clap::FromArgMatches;
use coseg::ranks;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::allocator::keep_freed_memory();
    cli::terminal::report_panics();
    cli::quiet::silence_drivers();
    let matches = cli::arguments();
    let name = matches.subcommand_name().unwrap_or_default();
    let cli = cli::Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    cli::terminal::show_warnings(cli.verbose);
    // Other commands do not divide their work.
    let started = match name {
        "train" => ranks::start(),
        _ => Ok(()),
    };
    cli::announce(&matches);
    let done = started
        .and_then(|()| cli.command.run(name))
        .and_then(|code| cli::terminal::finish().map(|()| code));
    let code = done.unwrap_or_else(|error| {
        cli::terminal::error(&error);
        ExitCode::FAILURE
    });
    // Others may wait for this one.
    ranks::abort();
    code
}
