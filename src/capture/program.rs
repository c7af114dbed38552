//! Other programs, run to their end or until they are stopped.

use crate::error::{Error, Result, clipped};
use crate::progress::Viewing;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::Duration;

/// Last lines of the output that an error quotes.
const QUOTED: usize = 5;
/// How often the run is asked whether to stop while a program prints nothing.
const PATIENCE: Duration = Duration::from_millis(100);

/// Runs `command` to its end. `done` gives the number of views of `viewing` that a line of output reports as done. When the run is
/// stopped, the program and its child processes are killed.
///
/// # Errors
/// [`Error::Program`] with its last lines where it fails; [`Error::Missing`] where it is not installed; `help` says what to do;
/// [`Error::Stopped`].
pub(super) fn run(
    command: &mut Command,
    help: &str,
    viewing: &mut Viewing<'_>,
    mut done: impl FnMut(&str) -> usize,
) -> Result<()> {
    let program = command.get_program().to_string_lossy().into_owned();
    command.stdin(Stdio::null());
    // One pipe for output and errors, so that their lines keep their order.
    let failed = |e| Error::io(&program, "start", e);
    let (output, input) = std::io::pipe().map_err(failed)?;
    command.stdout(input.try_clone().map_err(failed)?);
    command.stderr(input);
    // A process group of its own can be killed as a whole.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    let child = command.spawn().map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Error::missing("program", &program, help),
        _ => failed(e),
    })?;
    // The command holds ends of the pipe too.
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut running = Running(child);
    let (sender, lines) = mpsc::channel();
    read_lines(output, sender);
    let mut last = VecDeque::new();
    loop {
        let more = match lines.recv_timeout(PATIENCE) {
            Ok(line) => {
                let more = done(&line);
                last.push_back(clipped(line));
                if last.len() > QUOTED {
                    last.pop_front();
                }
                more
            }
            Err(RecvTimeoutError::Timeout) => 0,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        viewing.advance(more)?;
    }
    let status = running.0.wait();
    let status = status.map_err(|e| Error::io(&program, "wait for", e))?;
    if !status.success() {
        return Err(Error::Program {
            program,
            status: status.to_string(),
            output: if last.is_empty() {
                "none".to_owned()
            } else {
                Vec::from(last).join(" | ")
            },
            help: help.to_owned(),
        });
    }
    Ok(())
}

/// A running program. Dropping this kills it and its child processes.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        if !matches!(self.0.try_wait(), Ok(None)) {
            return;
        }
        // SAFETY: nobody has waited for the child yet, so its number still means its own process group.
        #[cfg(unix)]
        unsafe {
            libc::killpg(self.0.id().cast_signed(), libc::SIGKILL);
        }
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Sends the lines of `output` that are not blank.
fn read_lines(output: impl Read + Send + 'static, sender: Sender<String>) {
    std::thread::spawn(move || {
        let mut output = BufReader::new(output);
        let mut bytes = Vec::new();
        while output.read_until(b'\n', &mut bytes).is_ok_and(|n| n > 0) {
            let line = String::from_utf8_lossy(&bytes).trim().to_owned();
            if !line.is_empty() && sender.send(line).is_err() {
                return;
            }
            bytes.clear();
        }
    });
}
