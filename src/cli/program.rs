//! Other programs that a command calls.

use coseg::error::{Error, Result, clipped};
use std::io;
use std::process::Command;

/// Last lines of what a program says that an error quotes.
const QUOTED: usize = 5;

/// Runs `command` to its end. The help of errors: what to do where the program is `missing`, and where it fails.
pub fn run(command: &mut Command, missing: &str, failed: &str) -> Result<()> {
    let program = command.get_program().to_string_lossy().into_owned();
    let done = command.output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::missing("program", &program, missing),
        _ => Error::io(&program, "start", e),
    })?;
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let lines: Vec<&str> = said.trim().lines().collect();
    let last = &lines[lines.len().saturating_sub(QUOTED)..];
    Err(Error::Program {
        program,
        status: done.status.to_string(),
        output: clipped(last.join(" | ")),
        help: failed.to_owned(),
    })
}
