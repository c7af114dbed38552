//! Other programs that a command calls.

use coseg::error::{Error, Result, clipped};
use std::io;
use std::process::{Command, Output};

/// Last lines of what a program says that an error quotes.
const QUOTED: usize = 5;

/// Runs `command` to its end. The help of errors: what to do where the program is `missing`, and where it fails.
pub fn run(command: &mut Command, missing: &str, failed: &str) -> Result<()> {
    let done = output(command, missing)?;
    expect_success(command, &done, failed)
}

/// Runs `command` to its end, which may be a failure. `missing`: what to do where there is no such program.
pub fn output(command: &mut Command, missing: &str) -> Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    command.output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::missing("program", &program, missing),
        _ => Error::io(&program, "start", e),
    })
}

/// The error of `command` where it was `done` without success, with the last lines that it said. `failed`: what to do about it.
pub fn expect_success(command: &Command, done: &Output, failed: &str) -> Result<()> {
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let lines = said.lines().map(str::trim);
    let lines: Vec<&str> = lines.filter(|line| !line.is_empty()).collect();
    let last = &lines[lines.len().saturating_sub(QUOTED)..];
    Err(Error::Program {
        program: command.get_program().to_string_lossy().into_owned(),
        status: done.status.to_string(),
        output: clipped(last.join(" | ")),
        help: failed.to_owned(),
    })
}
