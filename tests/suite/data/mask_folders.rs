//! Folders of masks: which one is looked into, how files in it are named, when none is, and what is reported.

use crate::support::plates::{self, HEIGHT, WIDTH};
use crate::support::program::{succeeds, utf8};
use crate::support::transforms_json::edit;
use crate::support::{blender, colmap, scannet};
use coseg::data::mask::Mask;
use coseg::data::{LabelMap, LoadOptions, Scene, check, load};
use image::{GrayImage, Luma};
use serde_json::json;
use std::fs;
use std::path::Path;

fn named(masks: &str) -> LoadOptions {
    LoadOptions {
        masks: Some(masks.into()),
        ..LoadOptions::default()
    }
}

/// Black in the first `columns` columns.
fn write(path: &Path, (width, height): (u32, u32), columns: u32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_fn(width, height, |x, _| Luma([u8::from(x >= columns)]))
        .save(path)
        .unwrap();
}

/// Pixels that the mask of each view leaves out.
fn left_out(scene: &Scene) -> Vec<(&str, usize)> {
    let masked = |view: &'_ coseg::data::View| view.mask.as_ref().map(Mask::left_out);
    scene
        .views
        .iter()
        .filter_map(|view| Some((&*view.name, masked(view)?)))
        .collect()
}

#[test]
fn raw_labels_in_the_usual_folder_are_no_masks() {
    let folder = colmap::scene(colmap::text, &colmap::pinhole());
    let dir = folder.path();
    for i in 0..colmap::VIEWS {
        let ids = (0..192).map(|pixel| pixel % 3).collect();
        LabelMap {
            width: 16,
            height: 12,
            ids,
        }
        .write(&dir.join("masks").join(colmap::name(i)))
        .unwrap();
    }
    assert_eq!(
        left_out(&load(dir, &LoadOptions::default()).unwrap()).len(),
        colmap::VIEWS
    );
    let absolute = utf8(&dir.join("masks")).to_owned();
    for raw in ["masks", "./masks", "masks/", &absolute] {
        let options = LoadOptions {
            raw_labels: Some(raw.into()),
            ..LoadOptions::default()
        };
        let scene = load(dir, &options).unwrap();
        assert!(
            scene
                .views
                .iter()
                .all(|view| view.mask.is_none() && view.raw.is_some()),
            "{raw}"
        );
        assert!(
            check(dir, &options)
                .notices
                .iter()
                .all(|notice| !notice.contains("mask")),
            "{raw}"
        );
    }
    // Who names them as both means it by mistake, however it is written.
    let both = [
        "data.masks=./masks".to_owned(),
        "data.raw_labels=masks/".to_owned(),
    ];
    let error = coseg::config::Config::load(None, &both).unwrap_err();
    crate::support::assert_names(
        &error,
        &["data.masks", "other than data.images and data.raw_labels"],
    );
}

#[test]
fn masks_are_turned_off() {
    let folder = colmap::scene(colmap::text, &colmap::pinhole());
    for i in 0..colmap::VIEWS {
        write(
            &folder.path().join("masks").join(colmap::name(i)),
            (16, 12),
            3,
        );
        write(
            &folder.path().join("none").join(colmap::name(i)),
            (16, 12),
            5,
        );
    }
    for (options, each) in [
        (LoadOptions::default(), Some(36)),
        (named("none"), None),
        (named("./none"), Some(60)),
    ] {
        let scene = load(folder.path(), &options).unwrap();
        assert!(
            scene
                .views
                .iter()
                .all(|view| view.mask.as_ref().map(Mask::left_out) == each),
            "{options:?}"
        );
    }
    assert!(
        check(folder.path(), &named("none"))
            .notices
            .iter()
            .all(|notice| !notice.contains("mask"))
    );
    let plates = tempfile::tempdir().unwrap();
    plates::scene(plates.path());
    edit(plates.path(), |v| {
        v["frames"][1]["mask_path"] = json!("masks/is not there.png")
    });
    assert!(load(plates.path(), &LoadOptions::default()).is_err());
    assert!(left_out(&load(plates.path(), &named("none")).unwrap()).is_empty());
}

#[test]
fn a_folder_of_masks_that_is_not_used_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    plates::scene(dir);
    write(&dir.join("masks/v1.png"), (WIDTH as u32, HEIGHT as u32), 3);
    let told = |options: &LoadOptions| {
        let notices = check(dir, options).notices;
        let told = |notice: &String| notice.contains("masks/ is there and not used");
        notices.iter().any(told)
    };
    assert!(told(&LoadOptions::default()));
    assert!(!told(&named("none")));
    assert!(!told(&named("masks")));
    let raw = LoadOptions {
        raw_labels: Some(utf8(&dir.join("masks")).to_owned()),
        ..LoadOptions::default()
    };
    assert!(!told(&raw));
    edit(dir, |v| v["frames"][1]["mask_path"] = json!("masks/v1.png"));
    assert!(!told(&LoadOptions::default()));
}

#[test]
fn points_of_depth_images_are_not_of_what_is_left_out() {
    let folder = scannet::scene();
    let whole = load(folder.path(), &LoadOptions::default()).unwrap().points;
    // Of the one frame with depth, 8x6 points over 64x48 pixels, the left half.
    write(&folder.path().join("people/3.png"), (64, 48), 32);
    let rest = load(folder.path(), &named("people")).unwrap().points;
    assert_eq!((whole.len(), rest.len()), (48, 24));
    let right: Vec<_> = (0..48)
        .filter(|i| i % 8 >= 4)
        .map(|i| whole.positions[i])
        .collect();
    assert_eq!(rest.positions, right);
    // A mask that cannot be read is reported once.
    fs::write(folder.path().join("people/3.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    let problems = check(folder.path(), &named("people")).problems;
    assert_eq!(problems.len(), 1, "{problems:?}");
}

#[test]
fn photos_of_one_name_in_two_folders_have_masks_of_their_own() {
    let folder = blender::scene();
    let dir = folder.path();
    let size = (blender::SIZE, blender::SIZE);
    let each = blender::SIZE as usize;
    let masks = dir.join("masks");
    // By the path, by the name of the view, and by a name that several photos have.
    write(&masks.join("train/r_0.png"), size, 1);
    write(&masks.join("test/r_0.png"), size, 2);
    write(&masks.join("train_r_1.png"), size, 3);
    write(&masks.join("r_2.png"), size, 4);
    let found = [
        ("train_r_0", each),
        ("train_r_1", 3 * each),
        ("test_r_0", 2 * each),
    ];
    let scene = load(dir, &named("masks")).unwrap();
    assert_eq!(left_out(&scene), found);
    // Frames that say it themselves, with another folder in front; the same where raw labels are named so.
    fs::write(
        dir.join("classes.json"),
        r#"{"0": "void", "1": "a", "2": "b"}"#,
    )
    .unwrap();
    for (split, count, id) in [("train", 5, 1), ("test", 3, 2)] {
        let path = dir.join(format!("transforms_{split}.json"));
        let mut value = crate::support::program::read_json(&path);
        for i in 0..count {
            value["frames"][i]["mask_path"] = json!(format!("alpha/{split}/r_{i}.png"));
            value["frames"][i]["raw_label_path"] = json!(format!("seen/{split}/r_{i}.png"));
            let map = LabelMap {
                width: each,
                height: each,
                ids: vec![id; each * each],
            };
            map.write(&dir.join(format!("corrected/{split}/r_{i}.png")))
                .unwrap();
        }
        fs::write(&path, value.to_string()).unwrap();
    }
    let options = LoadOptions {
        raw_labels: Some("corrected".into()),
        ..named("masks")
    };
    let scene = load(dir, &options).unwrap();
    assert_eq!(left_out(&scene), found);
    for view in &scene.views {
        let id = 1 + u16::from(view.name.starts_with("test"));
        assert!(
            view.raw
                .as_ref()
                .unwrap()
                .runs()
                .all(|(found, _)| [0, id].contains(&found)),
            "{}",
            view.name
        );
    }
    // Without its map, that photo alone is unlabelled.
    fs::remove_file(dir.join("corrected/test/r_1.png")).unwrap();
    let scene = load(dir, &options).unwrap();
    let without = scene.views.iter().filter(|view| view.raw.is_none());
    let names: Vec<&str> = without.map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["test_r_1"]);
}

#[test]
fn masks_lie_as_their_photos_do() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    plates::scene(dir);
    let size = (WIDTH as u32, HEIGHT as u32);
    write(&dir.join("people/images/v0.png"), size, 1);
    write(&dir.join("people/v1.png"), size, 2);
    write(&dir.join("people/v3.png.png"), size, 3);
    // One mask that two frames name.
    write(&dir.join("people/rig.png"), size, 4);
    edit(dir, |v| {
        [4, 5]
            .into_iter()
            .for_each(|i| v["frames"][i]["mask_path"] = json!("masks/rig.png"))
    });
    let scene = load(dir, &named("people/")).unwrap();
    let found =
        [("v0", 1), ("v1", 2), ("v3", 3), ("v4", 4), ("v5", 4)].map(|(name, n)| (name, n * HEIGHT));
    assert_eq!(left_out(&scene), found);
}

#[test]
fn masks_that_leave_most_out_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    plates::scene(dir);
    let size = (WIDTH as u32, HEIGHT as u32);
    let told = || {
        let notices = check(dir, &named("masks")).notices;
        notices
            .into_iter()
            .filter(|notice| notice.contains("invert"))
            .collect::<Vec<_>>()
    };
    write(&dir.join("masks/v0.png"), size, 70);
    write(&dir.join("masks/v1.png"), size, 10);
    assert!(told().is_empty(), "half of both");
    write(&dir.join("masks/v1.png"), size, 20);
    assert_eq!(told().len(), 1);
    assert!(
        told()[0].contains("masks leave 56 % of the pixels of 2 views out"),
        "{:?}",
        told()
    );
    // One that leaves nothing out is not counted, nor by data info.
    write(&dir.join("masks/v2.png"), size, 0);
    assert!(told()[0].contains("2 views"));
    assert!(
        succeeds(&["data", "info", utf8(dir), "--set", "data.masks=masks"])
            .contains("masks  2 views")
    );
}

#[test]
fn a_mask_is_of_the_photo_as_it_lies_there() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    plates::scene(dir);
    edit(dir, |v| v["k1"] = json!(-0.2));
    let ring = |x: u32, y: u32| (f64::from(x) - 15.0).hypot(f64::from(y) - 20.0) as u32 % 8 < 5;
    let (w, h) = (WIDTH as u32, HEIGHT as u32);
    let mask = |width: u32| {
        let grow = width / (w / 2);
        let file = GrayImage::from_fn(width, h * width / w, |x, y| {
            Luma([u8::from(ring(x / grow, y / grow))])
        });
        fs::create_dir_all(dir.join("masks")).unwrap();
        file.save(dir.join("masks/v0.png")).unwrap();
        let scene = load(
            dir,
            &LoadOptions {
                max_side: WIDTH / 2,
                ..named("masks")
            },
        )
        .unwrap();
        scene.views[0].mask.clone().unwrap()
    };
    // Also where it has the size that photos are reduced to.
    let [half, whole] = [w / 2, w].map(mask);
    assert_eq!((half.width(), half.height()), (WIDTH / 2, HEIGHT / 2));
    assert_eq!(half, whole);
    assert_ne!(
        half,
        Mask::new(WIDTH / 2, HEIGHT / 2, |i| ring(
            i as u32 % (w / 2),
            i as u32 / (w / 2)
        ))
    );
}

#[test]
fn a_folder_that_is_missing_hides_no_other_problem() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    plates::scene(dir);
    fs::remove_file(dir.join("images/v1.png")).unwrap();
    let problems = check(dir, &named("nobody")).problems;
    assert_eq!(problems.len(), 2, "{problems:?}");
    crate::support::assert_names(
        &problems[0],
        &["nobody", "no such folder", "data.masks=none"],
    );
    crate::support::assert_names(&problems[1], &["images/v1.png"]);
}
