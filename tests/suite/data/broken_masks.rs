//! Masks that are refused.

use crate::support::masked_plates::{corner, grey, masked};
use coseg::Error;
use coseg::config::Config;
use coseg::data::{LoadOptions, check, load};
use image::ImageFormat;
use std::fs;
use std::path::Path;

#[track_caller]
fn refused(dir: &Path, options: &LoadOptions, parts: &[&str]) {
    let error: Error = load(dir, options).expect_err("an error");
    crate::support::assert_names(&error, parts);
    // A check reports the same.
    let problems = check(dir, options).problems;
    assert_eq!(problems[0].to_string(), error.to_string());
}

#[test]
fn broken_masks_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let options = LoadOptions::default();
    masked(dir);
    let file = dir.join("masks/v1.png");
    grey(64, 80, |_, _| true).save(&file).unwrap();
    refused(
        dir,
        &options,
        &[
            "masks/v1.png",
            "size",
            "64x80",
            "80x64",
            "its photo",
            "neither cut nor turned",
        ],
    );
    grey(80, 64, |_, _| false).save(&file).unwrap();
    refused(
        dir,
        &options,
        &["masks/v1.png", "all pixels", "black", "invert"],
    );
    corner().save_with_format(&file, ImageFormat::Jpeg).unwrap();
    refused(
        dir,
        &options,
        &["masks/v1.png", "JPEG", "PNG", "compression"],
    );
    fs::write(&file, b"\x89PNG\r\n\x1a\n").unwrap();
    refused(dir, &options, &["masks/v1.png", "end of the image"]);
    fs::remove_file(&file).unwrap();
    refused(
        dir,
        &options,
        &["masks/v1.png", "no such file", "put the mask there"],
    );
    // All faults of a frame at once: here also a label map that is not there.
    fs::remove_file(dir.join("labels/v1.png")).unwrap();
    assert_eq!(check(dir, &options).problems.len(), 2);
}

#[test]
fn photos_and_label_maps_are_no_folder_of_masks() {
    for sets in [
        &["data.masks=images"][..],
        &["data.masks=maps", "data.raw_labels=maps"],
    ] {
        let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
        crate::support::assert_names(
            &Config::load(None, &sets).unwrap_err(),
            &["data.masks", "other than data.images"],
        );
    }
    let config = Config::load(None, &["data.masks=people".into()]).unwrap();
    assert_eq!(
        LoadOptions::from(&config.data).masks.as_deref(),
        Some("people")
    );
    assert_eq!(LoadOptions::default().masks, None);
    assert!(
        Config::default()
            .to_toml()
            .unwrap()
            .contains("\nmasks = \"\"\n")
    );
}
