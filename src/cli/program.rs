//! Other programs that a command calls.

use coseg::error::{Error, Result, clipped};
use std::io;
use std::process::{Command, Output};

/// Number of last lines that an error quotes from a program.
const QUOTED: usize = 5;

/// Runs `command` to its end. `missing` and `failed` are the help of errors: what to do if there is no such program, and if it
/// fails.
pub fn run(command: &mut Command, missing: &str, failed: &str) -> Result<()> {
    let done = output(command, missing)?;
    expect_success(command, &done, failed)
}

/// Runs `command` to its end, which may be a failure. `missing`: what to do if there is no such program.
pub fn output(command: &mut Command, missing: &str) -> Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    command.output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::missing("program", &program, missing),
        _ => Error::io(&program, "start", e),
    })
}

/// An error with the last lines of `command`, if it is `done` without success. `failed`: what to do about it.
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
