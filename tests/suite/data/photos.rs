//! Photos stay in their files and label maps in runs: how much is in memory, and that nothing else changes.

use crate::support::plate_runs;
use crate::support::program::read_json;
use coseg::Error;
use coseg::data::{LabelMap, LabelRuns, LoadOptions, Photo, PhotoCache, Scene, load};
use coseg::pipeline::VariantOutcome;
use coseg::report::{HeldOutView, held_out_views};
use image::RgbImage;
use rayon::prelude::*;
use serde_json::json;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

const WIDTH: u32 = 400;
const HEIGHT: u32 = 300;
const VIEWS: usize = 8;
/// Bytes of a decoded photo.
const PHOTO: usize = (WIDTH * HEIGHT * 3) as usize;

/// Photos as PNG and JPEG, taken through a lens that bends them.
fn scene() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    fs::create_dir(dir.path().join("images")).expect("folder");
    let name = |i: usize| {
        format!(
            "images/v{i}.{}",
            if i.is_multiple_of(2) { "png" } else { "jpg" }
        )
    };
    for i in 0..VIEWS {
        picture(i as u32)
            .save(dir.path().join(name(i)))
            .expect("photo");
    }
    let pose = |i: usize| json!([[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let frames: Vec<_> = (0..VIEWS)
        .map(|i| json!({ "file_path": name(i), "transform_matrix": pose(i) }))
        .collect();
    let file = json!({
        "camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": 300.0, "fl_y": 300.0, "cx": 200.0, "cy": 150.0,
        "k1": -0.1, "frames": frames,
    });
    fs::write(dir.path().join("transforms.json"), file.to_string()).expect("transforms");
    dir
}

fn picture(i: u32) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        image::Rgb([(x + 31 * i) as u8, (y * (i + 1)) as u8, (x * y / 64) as u8])
    })
}

fn loaded(dir: &Path, decoded_mb: usize) -> Scene {
    load(
        dir,
        &LoadOptions {
            decoded_mb,
            ..LoadOptions::default()
        },
    )
    .expect("scene")
}

fn cache(scene: &Scene) -> &PhotoCache {
    scene.views[0].image.cache().expect("photos in files")
}

fn pixels(scene: &Scene, i: usize) -> Arc<RgbImage> {
    scene.views[i].image.pixels().expect("photo")
}

#[test]
fn no_more_photos_are_kept_than_the_budget_allows_and_all_are_as_ever() {
    let dir = scene();
    let plenty = loaded(dir.path(), 64);
    assert_eq!(cache(&plenty).bytes(), VIEWS * PHOTO);
    for (decoded_mb, room) in [(0, 0), (1, 2), (2, 5)] {
        let scene = loaded(dir.path(), decoded_mb);
        let kept = cache(&scene);
        assert_eq!(kept.budget(), decoded_mb << 20);
        for _ in 0..5 {
            (0..VIEWS).into_par_iter().for_each(|i| {
                assert!(pixels(&scene, i) == pixels(&plenty, i), "photo {i}");
                assert!(kept.bytes() <= kept.budget());
            });
            assert_eq!(kept.bytes(), room * PHOTO);
        }
    }
}

#[test]
fn photos_that_were_kept_stay() {
    let dir = scene();
    let scene = loaded(dir.path(), 1);
    let first: Vec<_> = (0..VIEWS).map(|i| pixels(&scene, i)).collect();
    let stayed = |i: usize| Arc::ptr_eq(&pixels(&scene, i), &first[i]);
    let kept: Vec<usize> = (0..VIEWS).filter(|i| stayed(*i)).collect();
    assert_eq!(kept.len(), 2);
    for round in 1..6 {
        let order = (0..VIEWS).map(|i| (3 * i + round) % VIEWS);
        assert_eq!(order.filter(|i| stayed(*i)).count(), 2, "round {round}");
    }
}

#[test]
fn photos_made_in_memory_are_as_they_were_made() {
    let photo = Photo::from(picture(3));
    assert_eq!(
        (photo.width(), photo.height()),
        (WIDTH as usize, HEIGHT as usize)
    );
    assert!(*photo.pixels().expect("pixels") == picture(3) && photo.cache().is_none());
}

#[test]
fn transparent_photos_are_told_from_opaque_ones() {
    let folder = scene();
    let path = std::fs::read_dir(folder.path().join("images"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .min()
        .unwrap();
    for (alpha, transparent) in [(255, false), (254, true), (0, true)] {
        let mut photo = image::DynamicImage::from(picture(0)).into_rgba8();
        photo.get_pixel_mut(1, 1).0[3] = alpha;
        photo
            .save_with_format(&path, image::ImageFormat::Png)
            .unwrap();
        let scene = loaded(folder.path(), 64);
        let found: Vec<bool> = scene
            .views
            .iter()
            .map(|view| view.image.is_transparent())
            .collect();
        let count = found.iter().filter(|&&found| found).count();
        assert_eq!(count, usize::from(transparent), "alpha {alpha}: {found:?}");
    }
}

#[test]
fn a_photo_that_changed_or_went_away_is_named() {
    let dir = scene();
    let scene = loaded(dir.path(), 0);
    let file = dir.path().join("images/v2.png");
    picture(5).save(&file).expect("photo");
    let error = scene.views[2].rgb().expect_err("another photo");
    crate::support::assert_names(
        &error,
        &[
            "v2.png",
            "content",
            "the scene was loaded with",
            "put it back",
        ],
    );
    fs::write(&file, b"\x89PNG\r\n\x1a\n").expect("write");
    crate::support::assert_names(
        &scene.views[2].rgb().expect_err("half a photo"),
        &["v2.png"],
    );
    fs::remove_file(&file).expect("remove");
    let error = scene.views[2].rgb().expect_err("no photo");
    assert!(
        matches!(&error, Error::Io { path, .. } if path.ends_with("v2.png")),
        "{error}"
    );
    picture(2).save(&file).expect("photo");
    scene.views[2].rgb().expect("the photo is back");
}

#[test]
fn a_run_that_keeps_no_decoded_photo_gives_the_same_bits() {
    let folder = tempfile::tempdir().expect("folder");
    crate::support::plates::scene(folder.path());
    let run = |decoded_mb: usize, threads: usize| {
        let mut config = plate_runs::config(folder.path());
        config.data.decoded_mb = decoded_mb;
        let out = folder.path().join(format!("run-{decoded_mb}"));
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        let outcome = pool.install(|| plate_runs::whole(&config, &out));
        let held = cache(&outcome.scene).bytes();
        (
            outcome,
            held,
            fs::read(out.join("scene.ply")).expect("scene"),
        )
    };
    let (plenty, held, ply) = run(64, 2);
    assert_eq!(
        held,
        plenty.scene.views.len()
            * crate::support::plates::WIDTH
            * crate::support::plates::HEIGHT
            * 3
    );
    let (none, held, other) = run(0, 3);
    assert_eq!(held, 0);
    plate_runs::same(&plenty, &none);
    assert!(ply == other, "scene.ply differs");
    assert_eq!(
        (plenty.test.psnr, plenty.test.ssim),
        (none.test.psnr, none.test.ssim)
    );
    let scores = |rows: &[VariantOutcome]| {
        rows.iter()
            .map(|row| row.scores.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(scores(&plenty.rows), scores(&none.rows));
}

#[test]
fn views_that_the_page_does_not_show_are_handed_over() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    crate::support::plates::scene(dir);
    let mut transforms = read_json(&dir.join("transforms.json"));
    let frames = transforms["frames"].as_array_mut().expect("frames");
    for i in 0..6 {
        fs::copy(
            dir.join(format!("images/v{i}.png")),
            dir.join(format!("images/w{i}.png")),
        )
        .expect("photo");
        let mut frame = frames[i].clone();
        (frame["file_path"], frame["split"]) = (json!(format!("images/w{i}.png")), json!("test"));
        frames.push(frame);
    }
    fs::write(dir.join("transforms.json"), transforms.to_string()).expect("transforms");
    let mut config = plate_runs::config(dir);
    (config.building.iterations, config.segmentation.rows) = (2, Some(Vec::new()));
    let outcome = plate_runs::whole(&config, &dir.join("run"));
    let mut names = Vec::new();
    let beside = |view: HeldOutView| {
        names.push(view.view.name.clone());
        Ok(())
    };
    let shown =
        held_out_views(&outcome, &config, &crate::support::device(), beside).expect("views");
    assert_eq!((shown.len(), names.len()), (6, 2));
    names.extend(shown.iter().map(|view| view.view.name.clone()));
    names.sort();
    assert_eq!(names, ["v2", "v5", "w0", "w1", "w2", "w3", "w4", "w5"]);
}

#[test]
fn label_maps_come_back_from_their_runs() {
    let blocks = |i: usize| (i / 37 % 5) as u16 * 300;
    let noise = |i: usize| (i as u16).wrapping_mul(40_503);
    let cases: [(&str, Vec<u16>, usize); 4] = [
        ("nothing", Vec::new(), 0),
        // 65,535 pixels are the longest run.
        ("one id", vec![7; 200_000], 4 * 4),
        ("blocks", (0..37_000).map(blocks).collect(), 4 * 1_000),
        ("noise", (0..1_000).map(noise).collect(), 2 * 1_000),
    ];
    for (name, ids, bytes) in cases {
        let map = LabelMap {
            width: ids.len() / 100,
            height: 100,
            ids,
        };
        let runs = LabelRuns::from(map.clone());
        assert_eq!(runs.bytes(), bytes, "{name}");
        assert_eq!((runs.width(), runs.height()), (map.width, map.height));
        let unrolled: Vec<u16> = runs
            .runs()
            .flat_map(|(id, n)| std::iter::repeat_n(id, n))
            .collect();
        assert!(unrolled == map.ids && runs.map() == map, "{name}");
    }
}

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
        let mut map = LabelMap::read(&path, &coseg::data::Limits::default()).expect("map");
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
            .expect_err("4 is no class now")
            .to_string()
            .contains("label id 4")
    );
}
