//! Notices on input that loads and is seldom intended: degenerate poses, odd intrinsics, labels that say nothing; and floods of one fault.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::data::{LabelMap, LoadOptions, check, load};
use serde_json::{Value, json};
use std::fs;
use tempfile::TempDir;

fn changed(change: impl Fn(&mut Value)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    edit(folder.path(), change);
    folder
}

fn for_frames(v: &mut Value, change: impl Fn(usize, &mut Value)) {
    v["frames"]
        .as_array_mut()
        .unwrap()
        .iter_mut()
        .enumerate()
        .for_each(|(i, frame)| change(i, frame));
}

/// The notices of the scene so changed, which has no problem.
#[track_caller]
fn notices(change: impl Fn(&mut Value)) -> Vec<String> {
    let folder = changed(change);
    let checked = check(folder.path(), &LoadOptions::default());
    assert!(checked.problems.is_empty(), "{checked:?}");
    checked.notices
}

/// Exactly one notice, which holds all of `parts`.
#[track_caller]
fn one(notices: &[String], parts: &[&str]) {
    assert_eq!(notices.len(), 1, "{notices:?}");
    parts
        .iter()
        .for_each(|part| assert!(notices[0].contains(part), "{part:?} is not in {notices:?}"));
}

#[test]
fn cameras_at_one_place_and_equal_poses_are_told() {
    assert_eq!(notices(|_| ()), Vec::<String>::new());
    let one_place = notices(|v| {
        for_frames(v, |_, frame| {
            (0..3).for_each(|r| frame["transform_matrix"][r][3] = json!(2.5))
        });
    });
    one(
        &one_place,
        &["transforms.json: all 6 cameras stand at one place"],
    );
    let copied = |v: &mut Value| {
        let pose = v["frames"][0]["transform_matrix"].clone();
        for_frames(v, |i, frame| {
            if i > 1 {
                frame["transform_matrix"] = pose.clone()
            }
        });
    };
    one(
        &notices(copied),
        &[
            "4 of 6 frames have exactly the pose of an earlier one: v2 as v0, v3 as v0, v4 as v0 and 1 more",
        ],
    );
    // A pose that cannot be read is a fault and no pose.
    let folder = changed(|v| {
        for_frames(v, |i, frame| {
            if i > 1 {
                frame["transform_matrix"] = json!([[1]])
            }
        })
    });
    let checked = check(folder.path(), &LoadOptions::default());
    assert_eq!(
        (checked.problems.len(), checked.notices.len()),
        (4, 0),
        "{checked:?}"
    );
}

#[test]
fn odd_intrinsics_are_told() {
    one(
        &notices(|v| v["cx"] = json!(900.0)),
        &[
            "transforms.json: intrinsics of v0, v1, v2 and 3 more: found",
            "principal point 900 for the 80 pixels along x",
            "expected",
            "a principal point on the photo",
        ],
    );
    one(
        &notices(|v| v["frames"][4]["cy"] = json!(-1.0)),
        &[
            "intrinsics of v4: found",
            "principal point -1 for the 64 pixels along y",
        ],
    );
    one(
        &notices(|v| v["fl_x"] = json!(2000)),
        &[
            "intrinsics of v0",
            "focal length 2000",
            "of 2.3 degrees",
            "along x",
            "5 to 170",
        ],
    );
    one(
        &notices(|v| v["fl_y"] = json!(2.5)),
        &["focal length 2.5", "of 171.1 degrees", "along y"],
    );
}

#[test]
fn a_scaled_rotation_is_named() {
    let folder = changed(|v| {
        for r in 0..3 {
            for c in 0..3 {
                let cell = &mut v["frames"][1]["transform_matrix"][r][c];
                *cell = json!(cell.as_f64().unwrap() * 0.25);
            }
        }
    });
    let fault = load(folder.path(), &LoadOptions::default()).unwrap_err();
    let parts = [
        "frames[1] (images/v1.png).transform_matrix",
        "a rotation times 0.25",
        "divide",
        "translation stays",
    ];
    crate::support::assert_names(&fault, &parts);
}

#[test]
fn raw_labels_that_say_nothing_are_told() {
    let folder = changed(|v| {
        _ = v["frames"][3]
            .as_object_mut()
            .unwrap()
            .remove("raw_label_path")
    });
    let dir = folder.path();
    let void = LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids: vec![0; WIDTH * HEIGHT],
    };
    // Test frames (2 and 5) do not count.
    for i in [1, 2] {
        void.write(&dir.join(format!("raw/v{i}.png"))).unwrap();
    }
    let found = check(dir, &LoadOptions::default()).notices;
    assert_eq!(found.len(), 2, "{found:?}");
    assert_eq!(
        found[0],
        "1 of 4 training frames have no raw labels: v3; 3 have some"
    );
    assert_eq!(
        found[1],
        "raw labels of 1 of 3 training frames are unlabelled in every pixel: v1"
    );
    for i in [0, 4] {
        void.write(&dir.join(format!("raw/v{i}.png"))).unwrap();
    }
    // Nothing is left to learn from.
    let found = check(dir, &LoadOptions::default());
    assert_eq!((found.notices.len(), found.problems.len()), (1, 1));
    let parts = ["3 of 3", "nothing to learn from", "look at the ids"];
    crate::support::assert_names(&found.problems[0], &parts);
    load(dir, &LoadOptions::default()).expect("the Gaussians can be built");
}

#[test]
fn a_flood_of_one_fault_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    scene(dir);
    edit(dir, |v| {
        let frames = v["frames"].as_array_mut().unwrap();
        for i in 6..40 {
            let mut frame = frames[0].clone();
            frame["file_path"] = json!(format!("images/absent{i}.png"));
            frames.push(frame);
        }
    });
    fs::remove_file(dir.join("labels/v3.png")).unwrap();
    let lines = |message: &str| {
        message
            .lines()
            .filter(|line| line.starts_with("error: "))
            .count()
    };
    let message = fails(&["data", "check", utf8(dir)], 1);
    assert!(
        message.contains("absent8.png") && !message.contains("absent9.png"),
        "{message}"
    );
    assert!(
        message.contains("error: .. and 31 more like it (--all shows them)"),
        "{message}"
    );
    assert!(
        message.contains("labels/v3.png") && message.contains("found 35 problems"),
        "{message}"
    );
    assert_eq!(lines(&message), 3 + 1 + 1 + 1, "{message}");
    let message = fails(&["data", "check", utf8(dir), "--all"], 1);
    assert!(
        message.contains("absent39.png") && !message.contains("more like it"),
        "{message}"
    );
    assert_eq!(lines(&message), 34 + 1 + 1, "{message}");
    assert!(succeeds(&["data", "check", "--help"]).contains("--all"));
}
