//! How a `transforms.json` says which frames are held out.

use crate::support::plates::scene;
use crate::support::transforms_json::edit;
use coseg::data::{LoadOptions, Split, check, load};
use serde_json::{Value, json};
use std::path::Path;
use tempfile::TempDir;

/// The small scene of six frames with these splits.
fn with_splits(words: [Value; 6]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    edit(folder.path(), |v| {
        for (frame, word) in v["frames"].as_array_mut().unwrap().iter_mut().zip(&words) {
            frame["split"] = word.clone();
        }
    });
    folder
}

/// Names of the views that are trained on and held out, joined by blanks.
fn split(dir: &Path) -> [String; 2] {
    let scene = load(dir, &LoadOptions::default()).unwrap();
    [Split::Train, Split::Test].map(|s| {
        scene
            .split(s)
            .map(|v| v.name.clone())
            .collect::<Vec<_>>()
            .join(" ")
    })
}

#[test]
fn validation_frames_are_held_out_where_nothing_else_is() {
    for word in ["val", "validation", "eval"] {
        let [t, v] = ["train", word].map(Value::from);
        let folder = with_splits([&t, &v, &t, &t, &v, &t].map(Value::clone));
        assert_eq!(split(folder.path()), ["v0 v2 v3 v5", "v1 v4"]);
        let checked = check(folder.path(), &LoadOptions::default());
        assert!(
            checked.problems.is_empty() && checked.notices.is_empty(),
            "{checked:?}"
        );
    }
}

#[test]
fn validation_frames_beside_test_frames_are_left_out() {
    let folder = with_splits(["train", "val", "test", "train", "val", "test"].map(Value::from));
    // A validation frame may have the name of another, as in Blender's folders: it is not read.
    edit(folder.path(), |v| {
        v["frames"][1]["file_path"] = json!("validation/v0.png")
    });
    assert_eq!(split(folder.path()), ["v0 v3", "v2 v5"]);
    let checked = check(folder.path(), &LoadOptions::default());
    assert_eq!(
        (checked.frames, checked.problems.len()),
        (4, 0),
        "{checked:?}"
    );
    assert!(
        checked.notices[0].starts_with("2 validation frames left out"),
        "{checked:?}"
    );
    let thin = LoadOptions {
        max_frames: 2,
        ..LoadOptions::default()
    };
    assert_eq!(load(folder.path(), &thin).unwrap().views.len(), 2);
    let folder = with_splits(["train", "val", "holdout", "train", "val", "test"].map(Value::from));
    let message = load(folder.path(), &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("\"holdout\", expected \"train\", \"test\" or \"val\""),
        "{message}"
    );
}

#[test]
fn lists_of_files_are_splits_as_in_nerfstudio() {
    let folder = with_splits([const { Value::Null }; 6]);
    edit(folder.path(), |v| {
        v["train_filenames"] = json!(["images/v0.png", "./images/v1.png", "images/v5.png"]);
        v["val_filenames"] = json!(["images/v3.png"]);
    });
    assert_eq!(split(folder.path()), ["v0 v1 v5", "v3"]);
    let notices = check(folder.path(), &LoadOptions::default()).notices;
    assert!(
        notices[0].starts_with("2 of 6 frames left out") && notices[0].contains("test_filenames"),
        "{notices:?}"
    );
    edit(folder.path(), |v| {
        v["test_filenames"] = json!(["images/v2.png"])
    });
    assert_eq!(split(folder.path()), ["v0 v1 v5", "v2"]);
    // What frames say comes first.
    edit(folder.path(), |v| {
        for (i, frame) in v["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
            frame["split"] = json!(if i == 4 { "test" } else { "train" });
        }
    });
    assert_eq!(split(folder.path()), ["v0 v1 v2 v3 v5", "v4"]);
}
