//! `coseg export` of plates.

use crate::support::plates::plates;
use crate::support::program::{coseg_in, fails, listed, succeeds, text, utf8};
use coseg::data::Classes;
use coseg::splat::{formats, ply};
use glam::DVec3;
use std::fs;
use std::path::Path;
use std::process::Command;

/// The plates as a scene with names, one of which cannot be a file's.
fn scene(folder: &Path) {
    let (gaussians, labels) = plates();
    ply::write(
        &folder.join("scene.ply"),
        &gaussians,
        DVec3::ZERO,
        Some(&labels),
    )
    .unwrap();
    let names = [(1, "red"), (2, "a/b: c"), (3, "blue"), (4, "wall")];
    Classes::from_names(0, names)
        .write(&folder.join("classes.json"))
        .unwrap();
}

#[test]
fn each_object_becomes_a_file() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let out = folder.path().join("parts");
    let scene = utf8(folder.path());
    let said = succeeds(&["export", "--scene", scene, "--out", utf8(&out)]);
    assert!(said.contains("4_wall.ply: 36 of 111 Gaussians"), "{said}");
    let files = [
        "1_red.ply",
        "2_a_b__c.ply",
        "3_blue.ply",
        "4_wall.ply",
        "classes.json",
    ];
    assert_eq!(listed(&out), files);
    let (gaussians, labels) = plates();
    let part = ply::read(&out.join("3_blue.ply")).unwrap();
    let rows: Vec<u32> = (0..111).filter(|&row| labels[row as usize] == 3).collect();
    assert_eq!(part.gaussians, gaussians.select(&rows));
    assert_eq!(part.labels, Some(vec![3; 25]));
    // Again is fine, but not beside objects that would stay.
    succeeds(&["export", "--scene", scene, "--out", utf8(&out)]);
    let only = [
        "export",
        "--scene",
        scene,
        "--out",
        utf8(&out),
        "--only",
        "red",
    ];
    let message = fails(&only, 1);
    assert!(
        message.contains("2_a_b__c.ply, expected a folder without scenes of another export"),
        "{message}"
    );
    let packed = folder.path().join("packed");
    succeeds(&[
        "export",
        "--scene",
        scene,
        "--out",
        utf8(&packed),
        "--only",
        "red,4",
        "--format",
        "spz",
    ]);
    let files = [
        "1_red.spz",
        "1_red.spz.labels.json",
        "4_wall.spz",
        "4_wall.spz.labels.json",
        "classes.json",
    ];
    assert_eq!(listed(&packed), files);
    let wall = utf8(&packed.join("4_wall.spz")).to_owned();
    let objects = succeeds(&["objects", "--scene", &wall]);
    assert!(
        objects.contains("wall") && objects.contains("36"),
        "{objects}"
    );
}

#[test]
fn a_scene_becomes_a_file_with_its_labels() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let path = |name: &str| folder.path().join(name);
    let scene = utf8(folder.path());
    for name in ["a/s.spz", "b/s.compressed.ply", "c/s.ply"] {
        succeeds(&["export", "--scene", scene, "--out", utf8(&path(name))]);
        let there = [&path(name), folder.path()]
            .map(|scene| succeeds(&["objects", "--scene", utf8(scene)]));
        let names = |text: &str| -> Vec<String> {
            text.lines()
                .map(|line| line.chars().take(24).collect())
                .collect()
        };
        assert_eq!(names(&there[0]), names(&there[1]));
        let back = path(&format!("{name}.ply"));
        succeeds(&["export", "--scene", utf8(&path(name)), "--out", utf8(&back)]);
        let back = ply::read(&back).unwrap();
        let read = formats::read(&path(name)).unwrap();
        assert_eq!((back.gaussians, back.labels), (read.gaussians, read.labels));
    }
    // Some objects in one file, in the order of the scene.
    succeeds(&[
        "export",
        "--scene",
        scene,
        "--out",
        utf8(&path("d/s.ply")),
        "--only",
        "blue,red",
    ]);
    let some = ply::read(&path("d/s.ply")).unwrap();
    assert_eq!(some.labels, Some([[1; 25], [3; 25]].concat()));
}

#[test]
fn scenes_without_labels_are_converted() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("a.splat"), [62; 320]).unwrap();
    let said = succeeds(&[
        "export",
        "--scene",
        utf8(&path("a.splat")),
        "--out",
        utf8(&path("a.spz")),
    ]);
    assert!(said.contains("a.spz: 10 of 10 Gaussians"), "{said}");
    assert_eq!(listed(folder.path()), ["a.splat", "a.spz"]);
    let message = fails(
        &[
            "export",
            "--scene",
            utf8(&path("a.splat")),
            "--out",
            utf8(&path("parts")),
        ],
        1,
    );
    assert!(message.contains("one label for each Gaussian"), "{message}");
    assert!(message.contains("a.splat.labels.json"), "{message}");
}

#[test]
fn formats_that_are_only_written_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    for format in ["glb", "las", "laz"] {
        let path = folder.path().join(format!("room.{format}"));
        fs::write(&path, "some bytes").unwrap();
        let message = fails(&["objects", "--scene", utf8(&path)], 1);
        let found = format!(
            "found .{format}, which is written but not read, expected a .ply, .spz, .sog or .splat file"
        );
        assert!(message.contains(&found), "{message}");
    }
}

#[test]
fn a_scene_without_its_file_of_labels_names_it() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    for name in ["s.spz", "s.compressed.ply"] {
        let path = folder.path().join("out").join(name);
        succeeds(&[
            "export",
            "--scene",
            utf8(folder.path()),
            "--out",
            utf8(&path),
        ]);
        fs::remove_file(path.with_file_name(format!("{name}.labels.json"))).unwrap();
        let message = fails(&["objects", "--scene", utf8(&path)], 1);
        assert!(
            message.contains(&format!("put {name}.labels.json")),
            "{message}"
        );
    }
}

#[test]
fn what_cannot_be_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let path = |name: &str| folder.path().join(name);
    let scene = path("scene.ply");
    let refused = |out: &Path, more: &[&str], expected: &str| {
        let arguments = [
            &["export", "--scene", utf8(&scene), "--out", utf8(out)],
            more,
        ]
        .concat();
        let message = fails(&arguments, 1);
        assert!(message.contains(expected), "{message}");
    };
    refused(&scene, &[], "a file other than the scene");
    refused(
        folder.path(),
        &[],
        "a folder without scenes of another export",
    );
    refused(&path("a.ply"), &["--format", "spz"], "--format");
    refused(&path("a.obj"), &[], "a name that ends in .ply");
    refused(&path("parts"), &["--only", "sofa"], "an id or a name");
    fs::write(path("b.spz"), "mine").unwrap();
    refused(&path("b.spz"), &[], "which this command did not write");
    succeeds(&[
        "export",
        "--scene",
        utf8(&scene),
        "--out",
        utf8(&path("b.spz")),
        "--force",
    ]);
    let program = Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args([
            "export",
            "--scene",
            utf8(&scene),
            "--out",
            utf8(&path("a.sog")),
        ])
        .env("PATH", "")
        .output()
        .unwrap();
    assert_eq!(program.status.code(), Some(1));
    let message = text(&program.stderr);
    assert!(
        message.contains("npm install -g @playcanvas/splat-transform"),
        "{message}"
    );
}

#[test]
fn names_and_cameras_of_earlier_exports_stay() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let path = |name: &str| folder.path().join(name);
    let labelled = utf8(folder.path());
    let first = path("out/first.spz");
    succeeds(&["export", "--scene", labelled, "--out", utf8(&first)]);
    let table = std::fs::read(path("out/classes.json")).unwrap();
    // Without its labels a scene has no names either.
    let bare = path("bare/cloud.spz");
    succeeds(&["export", "--scene", labelled, "--out", utf8(&bare)]);
    std::fs::remove_file(path("bare/cloud.spz.labels.json")).unwrap();
    let second = path("out/cloud.ply");
    succeeds(&["export", "--scene", utf8(&bare), "--out", utf8(&second)]);
    assert_eq!(std::fs::read(path("out/classes.json")).unwrap(), table);

    std::fs::write(path("names.json"), r#"{"1": "other"}"#).unwrap();
    let third = path("out/third.ply");
    let names = path("names.json");
    let mut other = vec!["export", "--scene", labelled, "--classes", utf8(&names)];
    other.extend(["--out", utf8(&third)]);
    let message = fails(&other, 1);
    assert!(
        message.contains("classes.json") && message.contains("found those of"),
        "{message}"
    );
    assert!(!third.exists());
    // The same for a name without a folder.
    let mut bare = other.clone();
    bare[6] = "third.ply";
    let output = coseg_in(&path("out"), &bare);
    assert_eq!(output.status.code(), Some(1));
    let message = text(&output.stderr);
    assert!(
        message.contains("classes: found those of cloud.ply"),
        "{message}"
    );
    assert!(!third.exists());
    assert_eq!(std::fs::read(path("out/classes.json")).unwrap(), table);
    other.push("--force");
    succeeds(&other);
    assert_ne!(std::fs::read(path("out/classes.json")).unwrap(), table);
}

#[test]
fn labels_of_others_are_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let out = folder.path().join("s.spz");
    let beside = folder.path().join("s.spz.labels.json");
    std::fs::write(&beside, "mine").unwrap();
    let arguments = [
        "export",
        "--scene",
        utf8(folder.path()),
        "--out",
        utf8(&out),
    ];
    let message = fails(&arguments, 1);
    assert!(message.contains("s.spz.labels.json"), "{message}");
    assert!(!out.exists());
    assert_eq!(std::fs::read(&beside).unwrap(), b"mine");
    succeeds(&[&arguments[..], &["--force"]].concat());
}
