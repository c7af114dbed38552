//! `coseg completions`: completion in a shell.

use super::Cli;
use clap::{Args, CommandFactory};
use clap_complete::{Shell, generate};
use coseg::error::{Error, Result};
use std::io::{self, Write};

const HELP: &str = "\
Examples:
  coseg completions bash > ~/.local/share/bash-completion/completions/coseg
  coseg completions zsh > ~/.zfunc/_coseg                               with ~/.zfunc in fpath
  coseg completions fish > ~/.config/fish/completions/coseg.fish";

/// Arguments of `coseg completions`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

impl CompletionsArgs {
    /// Prints the script.
    pub fn run(self) -> Result<()> {
        let mut script = Vec::new();
        generate(self.shell, &mut Cli::command(), "coseg", &mut script);
        let written = io::stdout().write_all(&script);
        written.map_err(|e| Error::io("standard output", "write", e))
    }
}
