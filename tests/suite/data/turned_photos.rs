//! Photos whose EXIF data ask programs to turn them: label maps of the turned photos do not fit, and the error says so.

use crate::support::assert_names;
use crate::support::exif_photo::photo;
use crate::support::plates::{HEIGHT, WIDTH, scene};
use coseg::Error;
use coseg::data::{LabelMap, LoadOptions, check, load};
use std::path::Path;
use tempfile::TempDir;

fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    scene(folder.path());
    folder
}

/// The error that `load` gives, the only one that `check` reports.
#[track_caller]
fn fault(dir: &Path) -> Error {
    let fault = load(dir, &LoadOptions::default()).expect_err("a fault");
    let problems = check(dir, &LoadOptions::default()).problems;
    assert!(
        problems.len() == 1 && problems[0].to_string() == fault.to_string(),
        "{problems:?}"
    );
    fault
}

/// Checks that `fault` has all `parts` and does not ask for a photo of another size.
#[track_caller]
fn assert_turned(fault: &Error, parts: &[&str]) {
    assert_names(fault, parts);
    let message = fault.to_string();
    assert!(!message.contains("scale the photo"), "{message}");
}

#[test]
fn label_maps_of_turned_photos_are_told_from_maps_of_another_size() {
    let folder = folder();
    let dir = folder.path();
    let turned = LabelMap {
        width: HEIGHT,
        height: WIDTH,
        ids: vec![1; WIDTH * HEIGHT],
    };
    turned.write(&dir.join("raw/v1.png")).expect("map");
    let parts = [
        "raw/v1.png",
        "64x80",
        "80x64, as its photo",
        "turned by 90 degrees",
        "EXIF",
        "before COLMAP",
    ];
    assert_turned(&fault(dir), &parts);
    // Where the photo says it, so does the error.
    photo(&dir.join("images/v1.png"), (WIDTH, HEIGHT), 6);
    assert_turned(&fault(dir), &parts);
    assert_turned(
        &fault(dir),
        &["its photo as it is stored, whose EXIF orientation is 6"],
    );
    // A map that is cut off is another matter.
    LabelMap {
        width: 64,
        height: 64,
        ids: vec![1; 64 * 64],
    }
    .write(&dir.join("raw/v1.png"))
    .expect("map");
    let message = fault(dir).to_string();
    assert!(
        message.contains("scale the map") && !message.contains("EXIF"),
        "{message}"
    );
}

#[test]
fn turned_photos_are_told_from_photos_of_another_size() {
    let folder = folder();
    photo(&folder.path().join("images/v4.png"), (HEIGHT, WIDTH), 8);
    assert_turned(
        &fault(folder.path()),
        &[
            "images/v4.png",
            "64x80 pixels, of EXIF orientation 8",
            "80x64",
            "transforms.json",
            "strip it",
        ],
    );
}

#[test]
fn photos_upside_down_are_told_of_where_they_have_labels() {
    let folder = folder();
    let dir = folder.path();
    let notices = || {
        let checked = check(dir, &LoadOptions::default());
        assert!(checked.problems.is_empty(), "{checked:?}");
        checked.notices
    };
    // Upright, and a quarter: there the size of the maps says that nothing was turned.
    for (i, orientation) in [(0, 1), (1, 6), (3, 8)] {
        photo(
            &dir.join(format!("images/v{i}.png")),
            (WIDTH, HEIGHT),
            orientation,
        );
    }
    assert!(
        notices().iter().all(|notice| !notice.contains("EXIF")),
        "{:?}",
        notices()
    );
    for (i, orientation) in [(2, 3), (4, 2)] {
        photo(
            &dir.join(format!("images/v{i}.png")),
            (WIDTH, HEIGHT),
            orientation,
        );
    }
    let found = notices();
    let told: Vec<_> = found
        .iter()
        .filter(|notice| notice.contains("EXIF"))
        .collect();
    assert_eq!(told.len(), 1, "{found:?}");
    assert!(
        told[0].starts_with("2 photos have an EXIF orientation") && told[0].contains(": v2, v4;"),
        "{told:?}"
    );
    load(dir, &LoadOptions::default()).expect("scene");
    crate::support::transforms_json::edit(dir, |v| {
        for frame in v["frames"].as_array_mut().expect("frames") {
            let frame = frame.as_object_mut().expect("frame");
            frame.remove("label_path");
            frame.remove("raw_label_path");
        }
    });
    assert!(
        notices().iter().all(|notice| !notice.contains("EXIF")),
        "nothing that may not fit"
    );
}
