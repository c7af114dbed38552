//! Label files that are not read: notices name them.

use crate::support::labelme_files::{colmap, labelme, shape, triangle};
use crate::support::raw_labels::{folder, labelled, options, write};
use coseg::config::RawFormat;
use coseg::data::{LoadOptions, check, load};
use serde_json::json;
use std::path::Path;

/// Whether a notice of the scene, which has no problem, holds all of `parts`.
#[track_caller]
fn told(dir: &Path, options: &LoadOptions, parts: &[&str]) -> bool {
    let checked = check(dir, options);
    assert!(checked.problems.is_empty(), "{:?}", checked.problems);
    let holds = |notice: &String| parts.iter().all(|part| notice.contains(part));
    checked.notices.iter().any(holds)
}

#[test]
fn label_maps_beside_files_of_labelme_are_told_and_copies_of_photos_are_not() {
    let folder = folder();
    let dir = folder.path();
    let file = labelme(&[shape("red", "polygon", triangle())]);
    write(dir, "raw/v3.json", &file);
    assert_eq!(
        labelled(&load(dir, &options("raw")).expect("scene")),
        ["v3"]
    );
    let parts = ["6 label maps are not read: v0, v1, v2", "data.raw_format"];
    assert!(told(dir, &options("raw"), &parts));
    let grey = LoadOptions {
        raw_format: RawFormat::Grey,
        ..options("raw")
    };
    assert_eq!(labelled(&load(dir, &grey).expect("scene")).len(), 6);
    assert!(!told(dir, &grey, &["are not read"]));
    // The photos are PNG.
    write(dir, "images/v3.json", &file);
    assert!(!told(dir, &options("images"), &["are not read"]));
}

#[test]
fn files_of_labelme_that_belong_to_no_photo_are_told() {
    let folder = folder();
    let dir = folder.path();
    let file = labelme(&[shape("red", "polygon", triangle())]);
    write(dir, "drawn/v3.json", &file);
    write(dir, "drawn/notes.json", &json!({ "area": 3 }));
    let part = "belong to no photo";
    assert!(!told(dir, &options("drawn"), &[part]));
    write(dir, "drawn/w1.json", &file);
    write(dir, "drawn/v3.png.json", &file);
    let parts = [
        "2 files of LabelMe belong to no photo",
        ": v3.png.json, w1.json",
    ];
    assert!(told(dir, &options("drawn"), &parts));
    // Other photos are there, but not read.
    let some = LoadOptions {
        stride: 2,
        ..options("drawn")
    };
    assert!(
        !check(dir, &some)
            .notices
            .iter()
            .any(|notice| notice.contains(part))
    );
    // Nothing is labelled.
    colmap(dir);
    assert!(!told(dir, &LoadOptions::default(), &[part]));
    write(dir, "labels_raw/w1.json", &file);
    assert!(told(
        dir,
        &LoadOptions::default(),
        &["1 files of LabelMe", part, "w1.json"]
    ));
}
