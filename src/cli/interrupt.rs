//! Ctrl-C in long commands: the first one asks for an orderly end, the second one ends the program.

use super::terminal;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit code of a run that was stopped, the shells' code for SIGINT.
const EXIT: u8 = 130;

/// When training stops after Ctrl-C, and what continues it.
pub const CHECKPOINT: &str = "after this step or view, with a checkpoint to resume from";
/// The same for training that may still be labelling photos.
pub const PHOTO_OR_STEP: &str = "after this photo, step or view; how to go on is printed then";
/// The same for commands without checkpoints. They keep each part that is done.
pub const SAME_COMMAND: &str = "after this part; the same command goes on from there";

static STOP_REQUESTED: AtomicBool = AtomicBool::new(false);

/// Whether Ctrl-C asked the run to stop.
pub fn stop_requested() -> bool {
    STOP_REQUESTED.load(Ordering::Relaxed)
}

/// Says how to continue a run that was stopped, and returns its exit code.
pub fn stopped(how: &str) -> ExitCode {
    terminal::note(&format!("stopped; {how}"));
    ExitCode::from(EXIT)
}

/// Takes Ctrl-C, and except on Windows SIGTERM and SIGHUP, as a request to stop. `how` says when the command stops and what continues
/// it. Call this once.
pub fn watch(how: &'static str) {
    let on_signal = move || {
        if STOP_REQUESTED.swap(true, Ordering::Relaxed) {
            std::process::exit(EXIT.into());
        }
        terminal::note(&format!(
            "stopping {how}; press Ctrl-C again to stop at once"
        ));
    };
    keeping_nohup(|| {
        if let Err(error) = ctrlc::set_handler(on_signal) {
            tracing::warn!("Ctrl-C will stop the run without saving: {error}");
        }
    });
}

/// Calls `set`, but a run under `nohup` still outlives its terminal.
#[cfg(unix)]
fn keeping_nohup(set: impl FnOnce()) {
    let mut action = std::mem::MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: without a new action this only stores the present one in `action`: plain numbers, for which zeros are valid too.
    let action = unsafe {
        libc::sigaction(libc::SIGHUP, std::ptr::null(), action.as_mut_ptr());
        action.assume_init()
    };
    set();
    if action.sa_sigaction == libc::SIG_IGN {
        // SAFETY: no handler is installed, the signal is ignored.
        unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
    }
}

/// Calls `set`: this system has no such signal.
#[cfg(not(unix))]
fn keeping_nohup(set: impl FnOnce()) {
    set();
}
