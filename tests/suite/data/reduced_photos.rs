//! Photos that are reduced, with their cameras and labels, and labels that datasets leave out.

use crate::support::bent_photos::{loaded, pixels, scene};
use coseg::data::{LabelMap, LoadOptions, load};
use image::RgbImage;
use std::fs;

#[test]
fn large_photos_are_reduced_with_their_cameras_and_labels() {
    let dir = tempfile::tempdir().expect("folder");
    crate::support::plates::scene(dir.path());
    let of = |max_side: usize| {
        load(
            dir.path(),
            &LoadOptions {
                max_side,
                ..LoadOptions::default()
            },
        )
        .expect("scene")
    };
    let (whole, half) = (of(0), of(40));
    assert_eq!(of(80).views[0].camera.width, 80, "as large as allowed");
    for (a, b) in whole.views.iter().zip(&half.views) {
        assert_eq!(
            (
                b.camera.width,
                b.camera.height,
                b.image.width(),
                b.image.height()
            ),
            (40, 32, 40, 32)
        );
        // The same rays.
        assert_eq!(a.camera.ray(20.0, 10.0), b.camera.ray(10.0, 5.0));
        let (large, small) = (
            a.image.pixels().expect("photo"),
            b.image.pixels().expect("photo"),
        );
        let mean = |image: &RgbImage| {
            image.as_raw().iter().map(|&v| f64::from(v)).sum::<f64>() / image.len() as f64
        };
        assert!(
            (mean(&large) - mean(&small)).abs() < 1.0,
            "{} {}",
            mean(&large),
            mean(&small)
        );
        // Bicubic with a kernel as wide as the reduction: within the ringing of a mean of four.
        let four = |x: u32, y: u32| {
            let at = |i: u32, j: u32| f64::from(large.get_pixel(2 * x + i, 2 * y + j)[1]);
            (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) / 4.0
        };
        let off = small
            .enumerate_pixels()
            .map(|(x, y, pixel)| (f64::from(pixel[1]) - four(x, y)).abs())
            .sum::<f64>();
        assert!(off / (40.0 * 32.0) < 3.0, "{off}");
        for (a, b) in [(&a.truth, &b.truth), (&a.raw, &b.raw)] {
            let (a, b) = (
                a.as_ref().expect("labels").map(),
                b.as_ref().expect("labels").map(),
            );
            assert_eq!((b.width, b.height), (40, 32));
            let near = |x: usize, y: usize| {
                [0, 1].iter().any(|i| {
                    [0, 1]
                        .iter()
                        .any(|j| a.ids[(2 * y + j) * 80 + 2 * x + i] == b.ids[y * 40 + x])
                })
            };
            assert!((0..32).all(|y| (0..40).all(|x| near(x, y))));
        }
    }
    // Maps that were made of the reduced scene fit it.
    half.views[0]
        .raw
        .as_ref()
        .expect("labels")
        .map()
        .write(&dir.path().join("raw/v0.png"))
        .expect("written");
    assert_eq!(of(40).views[0].raw, half.views[0].raw);
    let options = LoadOptions {
        max_side: 40,
        ..LoadOptions::default()
    };
    assert!(coseg::data::check(dir.path(), &options).problems.is_empty());
    let info = coseg::data::info(dir.path(), &options).expect("info");
    assert_eq!((info.labelled, info.raw_labelled), (6, 6));
    coseg::data::thumbnails(dir.path(), &options, 3, 20).expect("thumbnails");
    let cameras = coseg::data::load_cameras(
        dir.path(),
        &LoadOptions {
            max_side: 40,
            ..LoadOptions::default()
        },
        None,
    );
    assert_eq!(
        cameras.expect("cameras")[3].camera.width,
        40,
        "as the scene has them"
    );
    // Decoded again, a photo is the same.
    let again = load(
        dir.path(),
        &LoadOptions {
            max_side: 40,
            decoded_mb: 0,
            ..LoadOptions::default()
        },
    )
    .expect("scene");
    assert_eq!(pixels(&again, 3), pixels(&half, 3));
    // Through a lens that bends, too.
    let bent = scene();
    let reduced = load(
        bent.path(),
        &LoadOptions {
            max_side: 100,
            ..LoadOptions::default()
        },
    )
    .expect("scene");
    let (full, small) = (
        &loaded(bent.path(), 64).views[2].camera,
        &reduced.views[2].camera,
    );
    assert_eq!(
        (small.width, small.height, small.fx, small.cx),
        (100, 75, full.fx / 4.0, full.cx / 4.0)
    );
    let checked = coseg::data::check(
        bent.path(),
        &LoadOptions {
            max_side: 100,
            ..LoadOptions::default()
        },
    );
    assert!(
        checked.problems.is_empty()
            && checked
                .notices
                .iter()
                .any(|n| n.starts_with("8 photos have more than 100"))
    );
}

#[test]
fn what_datasets_leave_out_is_unlabelled_unless_a_class_has_that_id() {
    let dir = tempfile::tempdir().expect("folder");
    crate::support::plates::scene(dir.path());
    let raw = |id: u16| {
        let path = dir.path().join("raw/v0.png");
        let mut map = LabelMap::read(&path).expect("map");
        map.ids[0] = id;
        map.write(&path).expect("written");
        load(dir.path(), &LoadOptions::default())
            .map(|scene| scene.views[0].raw.as_ref().expect("labels").map().ids[0])
    };
    assert_eq!(raw(255).expect("scene"), 0);
    assert!(
        raw(254)
            .expect_err("no class")
            .to_string()
            .contains("label id 254")
    );
    let classes = dir.path().join("classes.json");
    let text = fs::read_to_string(&classes)
        .expect("classes")
        .replace("\"id\": 4", "\"id\": 255");
    fs::write(&classes, text).expect("written");
    assert!(
        raw(255)
            .expect_err("4 is not a class now")
            .to_string()
            .contains("label id 4")
    );
}
