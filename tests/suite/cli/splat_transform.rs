//! `coseg export` through splat-transform, with scripts in its place, and with the program where it is there.

use crate::support::glb::{glb, parsed};
use crate::support::plates::{plates, scene};
use crate::support::program::{listed, text, utf8};
use crate::support::programs::Sandbox;
use crate::support::skip_without_program;
use glam::DVec3;
use serde_json::json;
use std::fs;
use std::process::{Command, Output};

/// Exports the plates to `out` in the folder of `sandbox`; `path` is the PATH.
fn export(sandbox: &Sandbox, path: &str, out: &str, more: &[&str]) -> Output {
    let (plates, out) = (sandbox.path("room/plates.ply"), sandbox.path(out));
    let mut command = Command::new(env!("CARGO_BIN_EXE_coseg"));
    command.args(["export", "--scene", utf8(&plates), "--out", utf8(&out)]);
    command.args(more).env("PATH", path).output().unwrap()
}

/// A sandbox with the plates in the folder `room`.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.path("room")).unwrap();
    scene(&sandbox.path("room"));
    sandbox
}

/// A splat-transform that notes its arguments in `log`, with the file to write as `$last`.
fn program(sandbox: &Sandbox, body: &str) {
    let log = sandbox.path("log");
    let note = format!("echo \"$*\" >>'{}'; for last; do :; done", log.display());
    sandbox.script("splat-transform", &format!("{note}\n{body}"));
}

#[test]
fn labels_are_in_a_glb() {
    let sandbox = sandbox();
    let bin = sandbox.path("bin");
    let (gaussians, labels) = plates();
    let made = sandbox.path("made.glb");
    program(&sandbox, &format!("cp '{}' \"$last\"", made.display()));
    fs::write(&made, glb(&gaussians, DVec3::ZERO)).unwrap();
    let output = export(&sandbox, utf8(&bin), "out/room.glb", &[]);
    let message = text(&output.stderr);
    assert!(
        output.status.success() && !message.contains("warning"),
        "{message}"
    );
    let room = parsed(&fs::read(sandbox.path("out/room.glb")).unwrap());
    assert_eq!(room.labels(), labels);
    let names = json!({ "1": "red", "2": "green", "3": "blue", "4": "wall" });
    assert_eq!(room.json["meshes"][0]["extras"]["labels"], names);
    // Vertices in another order get none, and the user is told.
    let reversed: Vec<u32> = (0..gaussians.len() as u32).rev().collect();
    let other = glb(&gaussians.select(&reversed), DVec3::ZERO);
    fs::write(&made, &other).unwrap();
    let output = export(&sandbox, utf8(&bin), "out/room.glb", &[]);
    let message = text(&output.stderr);
    assert!(output.status.success(), "{message}");
    assert!(
        message.contains("has no labels") && message.contains("in another order"),
        "{message}"
    );
    assert_eq!(fs::read(sandbox.path("out/room.glb")).unwrap(), other);
}

#[test]
fn without_a_gpu_the_processor_writes_sog() {
    let sandbox = sandbox();
    let bin = sandbox.path("bin");
    let gpu = "case \"$*\" in *'--gpu cpu'*) echo sog >\"$last\";;
        *) echo 'TypeError: no adapter' >&2; echo '    at WebgpuGraphicsDevice.createDevice (cli.mjs:1:2)' >&2; exit 1;; esac";
    program(&sandbox, gpu);
    let output = export(&sandbox, utf8(&bin), "parts", &["--format", "sog"]);
    let message = text(&output.stderr);
    assert!(output.status.success(), "{message}");
    for warning in ["finds no GPU; it continues with --gpu cpu", "has no labels"] {
        assert_eq!(message.matches(warning).count(), 1, "{message}");
    }
    let files = [
        "1_red.sog",
        "2_green.sog",
        "3_blue.sog",
        "4_wall.sog",
        "classes.json",
    ];
    assert_eq!(listed(&sandbox.path("parts")), files);
    assert_eq!(
        fs::read(sandbox.path("parts/4_wall.sog")).unwrap(),
        b"sog\n"
    );
    // The GPU is looked for once.
    let calls: Vec<bool> = sandbox
        .log()
        .iter()
        .map(|line| line.contains("--gpu cpu"))
        .collect();
    assert_eq!(calls, [false, true, true, true, true]);
}

#[test]
fn other_failures_are_told_without_stack_lines() {
    let sandbox = sandbox();
    let bin = sandbox.path("bin");
    program(
        &sandbox,
        "echo 'Error: /mnt/gpu: no space left' >&2; echo 'at least two rows: write less' >&2; \
         echo '    at write (cli.mjs:1:2)' >&2; echo '    at new Promise (<anonymous>)' >&2; \
         echo '    at async file:///bin/cli.mjs:5:1' >&2; exit 3",
    );
    let output = export(&sandbox, utf8(&bin), "room.sog", &[]);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains(
            "its last lines: Error: /mnt/gpu: no space left | at least two rows: write less;"
        ),
        "{message}"
    );
    // A name with `gpu` in it is not a missing GPU.
    assert_eq!(sandbox.log().len(), 1);
    assert!(!sandbox.path("room.sog").exists());
}

#[test]
fn splat_transform_keeps_the_order_of_a_glb() {
    let version = Command::new("splat-transform").arg("--version").output();
    if !version.is_ok_and(|version| version.status.success()) {
        skip_without_program("splat-transform is not on the PATH");
        return;
    }
    let sandbox = sandbox();
    let path = std::env::var("PATH").unwrap();
    let output = export(&sandbox, &path, "room.glb", &[]);
    let message = text(&output.stderr);
    assert!(
        output.status.success() && !message.contains("warning"),
        "{message}"
    );
    let room = parsed(&fs::read(sandbox.path("room.glb")).unwrap());
    assert_eq!(room.labels(), plates().1);
}
