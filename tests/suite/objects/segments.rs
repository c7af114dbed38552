//! Raw labels whose ids mean something in their view alone: what is said where they are taken for classes, and photos in which
//! nothing was found.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::config::{Association, RawFormat};
use coseg::data::{LoadOptions, check, info, load};
use image::{GrayImage, Luma};
use std::fs;
use std::path::Path;

/// A folder of one mask for each photo but those of `without`, which have a table without rows alone.
fn masks(dir: &Path, without: &[usize]) {
    for i in 0..6 {
        let folder = dir.join(format!("sam/v{i}"));
        fs::create_dir_all(&folder).expect("folder");
        let found = !without.contains(&i);
        fs::write(
            folder.join("metadata.csv"),
            if found {
                "id,area\n0,1920\n"
            } else {
                "id,area\n"
            },
        )
        .expect("table");
        if found {
            let mask = GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, _| {
                Luma([if x < 30 { 255 } else { 0 }])
            });
            mask.save(folder.join("0.png")).expect("mask");
        }
    }
}

fn associated() -> LoadOptions {
    LoadOptions {
        raw_labels: Some("sam".into()),
        association: Association::Gaussians,
        ..LoadOptions::default()
    }
}

#[test]
fn a_photo_in_which_nothing_was_found_is_unlabelled() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    scene(dir);
    // The first one, too, by which the format is known.
    masks(dir, &[0, 3]);
    // Its size is that of the photo, lens and reduction or not.
    for (lens, max_side, size) in [(0.0, 0, (80, 64)), (-0.2, 40, (40, 32))] {
        edit(dir, |v| v["k1"] = lens.into());
        let options = LoadOptions {
            max_side,
            ..associated()
        };
        for (i, view) in load(dir, &options).expect("scene").views.iter().enumerate() {
            let map = view.raw.as_ref().expect("raw labels").map();
            assert_eq!((map.width, map.height), size);
            assert_eq!(map.ids.contains(&1), ![0, 3].contains(&i), "view {i}");
        }
        let checked = check(dir, &options);
        assert!(checked.problems.is_empty(), "{checked:?}");
        let told = |n: &String| {
            n.contains("raw labels of 2 of 4 training frames are unlabelled in every pixel: v0, v3")
        };
        assert!(checked.notices.iter().any(told), "{checked:?}");
        assert_eq!(info(dir, &options).expect("info").segments, 4);
    }
    // Without a table nobody says that nothing was found.
    fs::remove_file(dir.join("sam/v3/metadata.csv")).expect("remove");
    let error = load(dir, &associated()).expect_err("an empty folder");
    crate::support::assert_names(
        &error,
        &["sam/v3", "no PNG files", "metadata.csv without rows"],
    );
    // A table with rows whose files are gone does not say it either.
    fs::write(dir.join("sam/v3/metadata.csv"), "id,area\n0,1920\n").expect("table");
    crate::support::assert_names(
        &load(dir, &associated()).expect_err("a file is missing"),
        &["line 2, id", "0.png"],
    );
}

#[test]
fn commands_say_what_they_need_for_segments() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    scene(dir);
    masks(dir, &[]);
    let sheet = dir.join("sheet.png");
    let association = ["--set", "data.association=gaussians"];
    let look = [
        "data",
        "info",
        utf8(dir),
        "--sheet",
        utf8(&sheet),
        "--set",
        "data.raw_labels=sam",
    ];
    let message = fails(&look, 1);
    assert!(
        message.contains("folders of masks")
            && message.contains("add --set data.association=gaussians"),
        "{message}"
    );
    succeeds(&[&look[..], &association].concat());
    assert!(sheet.is_file());

    // Grey maps of ids: without a class table that is not the only thing to correct.
    edit(dir, |v| {
        let frames = v["frames"].as_array_mut().expect("frames");
        frames
            .iter_mut()
            .for_each(|frame| _ = frame.as_object_mut().expect("frame").remove("label_path"));
    });
    fs::remove_file(dir.join("classes.json")).expect("remove");
    let grey = ["data", "info", utf8(dir)];
    let message = fails(&grey, 1);
    for part in [
        "classes.json",
        "list the classes",
        "mean something in their view alone",
        "data.association=gaussians",
    ] {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    let said = succeeds(&[&grey[..], &association].concat());
    let joined = "% of their pixels, to be joined over Gaussians";
    assert!(said.contains(joined), "{said}");
    // True labels need a table all the same.
    edit(dir, |v| {
        v["frames"][2]["label_path"] = "labels/v2.png".into()
    });
    let message = fails(&grey, 1);
    assert!(
        message.contains("list the classes") && !message.contains("data.association"),
        "{message}"
    );
    let options = LoadOptions {
        raw_format: RawFormat::Grey,
        ..associated()
    };
    crate::support::assert_names(
        &load(dir, &options).expect_err("no table"),
        &["classes.json", "list the classes"],
    );
}
