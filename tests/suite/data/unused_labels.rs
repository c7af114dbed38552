//! Label files that are not read: notices name them.

use crate::support::assert_names;
use crate::support::labelme_files::{colmap, labelme, shape, triangle};
use crate::support::raw_labels::{folder, labelled, options, refused, write};
use crate::support::transforms_json::edit;
use coseg::config::RawFormat;
use coseg::data::{LoadOptions, check, info, load};
use serde_json::json;
use std::path::Path;
use tempfile::TempDir;

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
    let checked = check(dir, &LoadOptions::default());
    let parts = ["1 files of LabelMe", part, "w1.json"];
    let holds = |notice: &String| parts.iter().all(|part| notice.contains(part));
    assert!(checked.notices.iter().any(holds), "{checked:?}");
    only_problem(dir, &["labels_raw", "found w1.json", "like its photo"]);
}

/// The one problem of the scene, which holds all of `parts`; the scene is loaded all the same.
#[track_caller]
fn only_problem(dir: &Path, parts: &[&str]) {
    let checked = check(dir, &LoadOptions::default());
    assert_eq!(checked.problems.len(), 1, "{checked:?}");
    assert_names(&checked.problems[0], parts);
    load(dir, &LoadOptions::default()).expect("a scene without raw labels");
    let notices = info(dir, &LoadOptions::default()).expect("info").notices;
    assert!(
        notices.contains(&checked.problems[0].to_string()),
        "{notices:?}"
    );
}

/// A scene whose frames name no raw labels.
fn unnamed() -> TempDir {
    let folder = folder();
    edit(folder.path(), |scene| {
        for frame in scene["frames"].as_array_mut().expect("frames") {
            _ = frame
                .as_object_mut()
                .expect("frame")
                .remove("raw_label_path");
        }
    });
    folder
}

#[test]
fn a_folder_of_raw_labels_without_one_for_any_photo_is_a_problem() {
    let folder = unnamed();
    let dir = folder.path();
    let default = LoadOptions::default();
    assert!(check(dir, &default).problems.is_empty());
    let labels = dir.join("labels_raw");
    std::fs::create_dir(&labels).expect("folder");
    only_problem(
        dir,
        &["labels_raw: raw labels: found no file", "v0.png for v0.png"],
    );
    for i in 0..6 {
        let map = labels.join(format!("v{i}.jpg"));
        image::GrayImage::new(8, 8).save(map).expect("a map");
    }
    let found = "found 6 files, none of which is a PNG named like a photo: v0.jpg, v1.jpg";
    only_problem(dir, &[found, "save the ids as PNG"]);
    // A folder that is named says what is there in place of each map.
    let parts = ["labels_raw/v0.png", "save it as PNG", "(v0.jpg is there)"];
    refused(dir, &options("labels_raw"), &parts);
    // But a photo is no label map of itself.
    for i in 0..6 {
        let photo = dir.join(format!("images/v{i}.png"));
        let pixels = image::open(&photo).expect("a photo").into_rgb8();
        pixels.save(photo.with_extension("jpg")).expect("a photo");
        std::fs::remove_file(photo).expect("removed");
    }
    edit(dir, |scene| {
        for (i, frame) in (0..).zip(scene["frames"].as_array_mut().expect("frames")) {
            frame["file_path"] = json!(format!("images/v{i}.jpg"));
        }
    });
    let fault = load(dir, &options("images")).expect_err("no labels");
    assert_names(
        &fault,
        &["no such file", "images/v0.png; put the label map there"],
    );
    // A file of COCO or CVAT is read where it is named.
    std::fs::remove_dir_all(&labels).expect("removed");
    write(
        dir,
        "labels_raw/instances.json",
        &json!({ "annotations": [] }),
    );
    only_problem(
        dir,
        &["--set data.raw_labels=labels_raw/instances.json reads that file"],
    );
    // One map is enough.
    std::fs::copy(dir.join("raw/v3.png"), labels.join("v3.png")).expect("copied");
    assert!(check(dir, &default).problems.is_empty());
}

#[test]
fn label_maps_of_no_photo_are_told() {
    let folder = unnamed();
    let dir = folder.path();
    let labels = dir.join("labels_raw");
    std::fs::rename(dir.join("raw"), &labels).expect("renamed");
    let part = "belong to no photo";
    assert!(!told(dir, &LoadOptions::default(), &[part]));
    // A photo that is no frame has a map, and another photo two.
    for copy in ["w.png", "v1.png.png", "v1_mask.png"] {
        std::fs::copy(labels.join("v1.png"), labels.join(copy)).expect("copied");
    }
    std::fs::copy(dir.join("images/v1.png"), dir.join("images/w.png")).expect("copied");
    let parts = ["1 label maps in", "labels_raw", part, ": v1_mask.png"];
    assert!(told(dir, &LoadOptions::default(), &parts));
    assert!(told(dir, &options("labels_raw"), &parts));
    let some = LoadOptions {
        stride: 2,
        ..LoadOptions::default()
    };
    assert!(!told(dir, &some, &[part]));
}

#[test]
fn files_of_labelme_beside_the_photos_are_told() {
    let folder = unnamed();
    let dir = folder.path();
    let part = "files of LabelMe in images are not read: --set data.raw_labels=images reads them";
    // Other programs write a file for each photo, too.
    write(dir, "images/v0.json", &json!({ "pose": [] }));
    assert!(!told(dir, &LoadOptions::default(), &["LabelMe"]));
    let file = labelme(&[shape("red", "polygon", triangle())]);
    for name in ["v0", "v3", "other"] {
        write(dir, &format!("images/{name}.json"), &file);
    }
    assert!(told(dir, &LoadOptions::default(), &["2 ", part]));
    assert_eq!(
        labelled(&load(dir, &options("images")).expect("scene")),
        ["v0", "v3"]
    );
    assert!(!told(dir, &options("images"), &[part]));
    colmap(dir);
    assert!(told(dir, &LoadOptions::default(), &["2 ", part]));
}
