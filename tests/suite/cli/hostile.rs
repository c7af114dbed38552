//! Arguments, files and terminals that mean harm.

use crate::support::plates::scene;
use crate::support::program::{fails, text, utf8};
use std::fs;
use std::process::{Command, Stdio};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_coseg"))
}

#[test]
fn one_process_at_a_time_writes_a_run_folder() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    fs::create_dir(&run).unwrap();
    let held = fs::File::create(run.join(".coseg-lock")).unwrap();
    held.try_lock().unwrap();
    fs::write(run.join(".coseg-lock"), "4711\n").unwrap();
    let train = ["train", "--data", utf8(folder.path()), "--out", utf8(&run)];
    let message = fails(&train, 1);
    assert!(
        message.contains("process 4711") && message.contains("one process at a time"),
        "{message}"
    );
    drop(held);
    // A file of that name that is not a lock stays as it is.
    fs::write(run.join(".coseg-lock"), "a text of mine").unwrap();
    let message = fails(&train, 1);
    assert!(message.contains(".coseg-lock: content"), "{message}");
    assert_eq!(
        fs::read(run.join(".coseg-lock")).unwrap(),
        b"a text of mine"
    );
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.ply");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    let message = fails(&["view", "--scene", utf8(&pipe)], 1);
    assert!(
        message.contains("pipe.ply: kind: found a pipe or a device"),
        "{message}"
    );
    let message = fails(&["train", "--config", "/dev/zero"], 1);
    assert!(message.contains("/dev/zero: kind"), "{message}");
    let message = fails(&["view", "--scene", "/dev/zero", "--out", "page.html"], 1);
    assert!(message.contains("/dev/zero: kind"), "{message}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_printed_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let output = program()
        .args(["data", "info", utf8(folder.path()), "--json"])
        .stdout(full)
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("standard output: write failed"),
        "{message}"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn an_argument_that_is_no_unicode_is_an_error() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join(std::ffi::OsStr::from_bytes(b"run\xff"));
    let output = program()
        .args([
            "train",
            "--data",
            utf8(folder.path()),
            "--set",
            "segmentation.rows=raw",
        ])
        .args([
            "--set",
            "building.iterations=1",
            "--set",
            "building.random_points=50",
            "--out",
        ])
        .arg(&run)
        .output()
        .unwrap();
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(run.join("report.html").is_file());
}

#[cfg(target_os = "linux")]
#[test]
fn names_do_not_command_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let classes = folder.path().join("classes.json");
    fs::write(
        &classes,
        r#"{"1": "red\u001b[2J", "2": "green", "3": "blue", "4": "wall"}"#,
    )
    .unwrap();
    let message = fails(&["data", "check", utf8(folder.path())], 1);
    assert!(
        message.contains("id 1") && message.contains("control characters"),
        "{message}"
    );
    let scene = folder.path().join("a\u{1b}[2J\nerror: b.ply");
    let message = fails(&["view", "--scene", utf8(&scene)], 1);
    assert!(
        !message.contains('\u{1b}')
            && message.lines().count() == 2
            && message.contains("\\u001b[2J\\nerror: b.ply"),
        "{message:?}"
    );
}

#[test]
fn messages_stay_short() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("long.toml");
    fs::write(&file, format!("seed = {}", "x".repeat(100_000))).unwrap();
    let message = fails(&["train", "--config", utf8(&file)], 1);
    assert!(
        message.contains("long.toml") && message.len() < 2_000,
        "{} bytes",
        message.len()
    );
}

#[test]
fn what_stage_two_needs_is_there_before_stage_one() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let absent = folder.path().join("absent");
    let absent = utf8(&absent);
    let maps = folder.path().join("maps");
    fs::create_dir(&maps).unwrap();
    for (set, part) in [
        (format!("features.weights={absent}"), "absent"),
        (format!("features.source.import={absent}"), "absent"),
        (format!("features.source.import={}", utf8(&maps)), "v0"),
        (format!("spatial.source.pretrained={absent}"), "absent"),
    ] {
        let train = ["train", "--data", utf8(folder.path()), "--out", utf8(&run)];
        let message = fails(&[&train[..], &["--set", &set]].concat(), 1);
        assert!(
            message.contains(part) && !message.contains("building"),
            "{set}: {message}"
        );
        assert!(!run.exists(), "{set}: nothing was begun");
    }
}
