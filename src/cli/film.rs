//! A film of rendered frames, by ffmpeg.

use coseg::error::{Error, Result};
use coseg::files::{atomic, own};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

const FILM: &str = "film.mp4";
/// Last lines of what ffmpeg says that an error quotes.
const QUOTED: usize = 5;
const MISSING: &str = "install ffmpeg (apt-get install ffmpeg, brew install ffmpeg), or leave --film out: the frames are pictures too";

/// Refuses to begin without ffmpeg, or over a film of something else in the folder `out`.
pub fn check(out: &Path) -> Result<()> {
    own::check(out.join(FILM))?;
    ffmpeg(Command::new("ffmpeg").arg("-version"), MISSING)
}

/// Writes a film of the pictures in the folder `out` whose names follow `pattern`, as of printf. Returns its name.
pub fn write(out: &Path, pattern: &str) -> Result<PathBuf> {
    let film = out.join(FILM);
    let failed = |e| Error::io(&film, "write", e);
    let folder = tempfile::tempdir().map_err(failed)?;
    let made = folder.path().join(FILM);
    let mut command = Command::new("ffmpeg");
    // The folder is no part of the name, in which ffmpeg looks for patterns.
    command.current_dir(out);
    command.args(["-nostdin", "-loglevel", "error", "-framerate", "30"]);
    command.args(["-i", pattern, "-pix_fmt", "yuv420p"]);
    // Most players need even sizes, and the index in front of the pictures.
    command.args([
        "-vf",
        "pad=ceil(iw/2)*2:ceil(ih/2)*2",
        "-movflags",
        "+faststart",
    ]);
    ffmpeg(
        command.arg(&made),
        "the frames are there: make a film of them by another program",
    )?;
    atomic::write_bytes(&film, &std::fs::read(&made).map_err(failed)?)?;
    Ok(film)
}

/// Runs ffmpeg to its end; `help` says what to do where it fails.
fn ffmpeg(command: &mut Command, help: &str) -> Result<()> {
    let done = command.output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::missing("program", "ffmpeg", MISSING),
        _ => Error::io("ffmpeg", "start", e),
    })?;
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let lines: Vec<&str> = said.lines().collect();
    let last = &lines[lines.len().saturating_sub(QUOTED)..];
    Err(Error::Program {
        program: "ffmpeg".to_owned(),
        status: done.status.to_string(),
        output: last.join(" | "),
        help: help.to_owned(),
    })
}
