//! `coseg render --film`, with a script in the place of ffmpeg, and with ffmpeg where it is there.

use crate::support::program::{listed, read_json, text, utf8};
use crate::support::programs::Sandbox;
use crate::support::rendered_views::run_folder;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Three frames of 41 x 33 pixels and a film in the folder `out`, with `path` as PATH.
fn film(run: &Path, out: &Path, path: &str, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_coseg"));
    command.args(["render", "--scene", utf8(run), "--out", utf8(out)]);
    command.args([
        "--path", "sway", "--frames", "3", "--size", "41,33", "--film",
    ]);
    command.args(more).env("PATH", path).output().unwrap()
}

#[test]
fn ffmpeg_makes_a_film_of_the_frames() {
    let sandbox = Sandbox::new();
    let run = run_folder(sandbox.0.path());
    let [bin, out] = ["bin", "film %d"].map(|name| sandbox.path(name));
    let log = sandbox.path("log");
    // The last argument is the file to write.
    let script = format!(
        "echo \"$*\" >>'{}'; for last; do :; done; test \"$last\" = -version || cat path_000?.rgb.png >\"$last\"",
        log.display()
    );
    sandbox.script("ffmpeg", &script);
    let output = film(&run, &out, utf8(&bin), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("film.mp4"), "{output:?}");
    let frames = (0..3).map(|i| fs::read(out.join(format!("path_000{i}.rgb.png"))).unwrap());
    let frames: Vec<Vec<u8>> = frames.collect();
    assert_eq!(fs::read(out.join("film.mp4")).unwrap(), frames.concat());
    assert!(
        fs::read_to_string(&log)
            .unwrap()
            .contains("-i path_%04d.rgb.png")
    );
    // Again over its own film, but not over one of somebody else.
    assert!(film(&run, &out, utf8(&bin), &[]).status.success());
    fs::write(out.join("film.mp4"), "mine").unwrap();
    let output = film(&run, &out, utf8(&bin), &[]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(fs::read_to_string(out.join("film.mp4")).unwrap(), "mine");

    sandbox.script(
        "ffmpeg",
        "test \"$1\" = -version || { echo no encoder >&2; exit 3; }",
    );
    let output = film(&run, &sandbox.path("other"), utf8(&bin), &[]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("ffmpeg") && message.contains("no encoder"),
        "{message}"
    );
    assert!(!sandbox.path("other/film.mp4").exists());
}

#[test]
fn without_ffmpeg_nothing_is_rendered() {
    let sandbox = Sandbox::new();
    let run = run_folder(sandbox.0.path());
    let [bin, out] = ["bin", "film"].map(|name| sandbox.path(name));
    let output = film(&run, &out, utf8(&bin), &[]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("ffmpeg") && message.contains("apt-get"),
        "{message}"
    );
    assert!(!out.exists() || listed(&out).is_empty());
    let output = film(&run, &out, utf8(&bin), &["--format", "npy"]);
    assert!(text(&output.stderr).contains("--format png"));
}

#[test]
fn the_real_ffmpeg_makes_a_film_of_odd_frames() {
    let probe = |arguments: &[&str]| Command::new("ffprobe").args(arguments).output();
    if probe(&["-version"]).is_err() {
        eprintln!("SKIPPED: no ffmpeg");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let out = folder.path().join("film %d");
    let output = film(&run, &out, &std::env::var("PATH").unwrap(), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let film = out.join("film.mp4");
    let arguments = [
        "-v",
        "error",
        "-count_frames",
        "-show_streams",
        "-of",
        "json",
        utf8(&film),
    ];
    let shown = folder.path().join("shown.json");
    fs::write(&shown, probe(&arguments).unwrap().stdout).unwrap();
    let stream = &read_json(&shown)["streams"][0];
    assert_eq!([&stream["width"], &stream["height"]], [42, 34]);
    assert_eq!(stream["nb_read_frames"], "3");
    assert_eq!(stream["pix_fmt"], "yuv420p");
}
