//! A film of rendered frames, by ffmpeg.

use coseg::error::{Error, Result, ensure};
use coseg::files::{atomic, own};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const FILM: &str = "film.mp4";
const HELP: &str = "install ffmpeg (apt-get install ffmpeg, brew install ffmpeg), or leave --film out: the frames are pictures too";

/// Refuses to begin without ffmpeg, or over a film of something else in the folder `out`.
pub fn check(out: &Path) -> Result<()> {
    own::check(out.join(FILM))?;
    ffmpeg(Command::new("ffmpeg").arg("-version")).map(drop)
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
    let done = ffmpeg(command.arg(&made))?;
    let said = String::from_utf8_lossy(&done.stderr);
    ensure!(done.status.success(), argument "--film"; found "an error of ffmpeg: {}", said.trim();
        expected "a film"; help "the frames are there: make a film of them by another program");
    atomic::write_bytes(&film, &std::fs::read(&made).map_err(failed)?)?;
    Ok(film)
}

fn ffmpeg(command: &mut Command) -> Result<Output> {
    command.output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::missing("program", "ffmpeg", HELP),
        _ => Error::io("ffmpeg", "start", e),
    })
}
