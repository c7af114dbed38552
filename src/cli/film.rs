//! A film of rendered frames, by ffmpeg.

use super::program;
use coseg::error::{Error, Result};
use coseg::files::{atomic, own};
use std::path::{Path, PathBuf};
use std::process::Command;

const FILM: &str = "film.mp4";
const MISSING: &str = "install ffmpeg (apt-get install ffmpeg, brew install ffmpeg), or leave --film out: the frames are pictures too";

/// Refuses to begin without ffmpeg, or over a film of something else in the folder `out`.
pub fn check(out: &Path) -> Result<()> {
    own::check(out.join(FILM))?;
    program::run(Command::new("ffmpeg").arg("-version"), MISSING, MISSING)
}

/// Writes a film of the pictures in the folder `out` whose names follow `pattern`, as in printf. Returns its name.
pub fn write(out: &Path, pattern: &str) -> Result<PathBuf> {
    let film = out.join(FILM);
    let failed = |e| Error::io(&film, "write", e);
    let folder = tempfile::tempdir().map_err(failed)?;
    let made = folder.path().join(FILM);
    let mut command = Command::new("ffmpeg");
    // ffmpeg looks for patterns in the whole name, so the folder is not a part of it.
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
    let help = "the frames are there: make a film of them with another program";
    program::run(command.arg(&made), MISSING, help)?;
    atomic::write_bytes(&film, &std::fs::read(&made).map_err(failed)?)?;
    Ok(film)
}
