//! Photos stay in their files and label maps in runs: how much is in memory, and that nothing else changes.

use crate::support::bent_photos::{
    HEIGHT, PHOTO, VIEWS, WIDTH, kept, loaded, picture, pixels, scene,
};
use crate::support::plate_runs;
use crate::support::program::read_json;
use coseg::Error;
use coseg::data::{LabelMap, LabelRuns, Photo};
use coseg::pipeline::VariantOutcome;
use coseg::report::{HeldOutView, held_out_views};
use rayon::prelude::*;
use serde_json::json;
use std::fs;
use std::sync::Arc;

#[test]
fn no_more_photos_are_kept_than_the_budget_allows_and_all_are_as_ever() {
    let dir = scene();
    let plenty = loaded(dir.path(), 64);
    assert_eq!(kept(&plenty), VIEWS);
    for (decoded_mb, room) in [(0, 0), (1, 2), (2, 5)] {
        let scene = loaded(dir.path(), decoded_mb);
        assert!(room * PHOTO <= decoded_mb << 20);
        for _ in 0..5 {
            (0..VIEWS).into_par_iter().for_each(|i| {
                assert!(pixels(&scene, i) == pixels(&plenty, i), "photo {i}");
            });
            assert_eq!(kept(&scene), room);
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
    assert!(*photo.pixels().expect("pixels") == picture(3));
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
        let held = kept(&outcome.scene);
        (
            outcome,
            held,
            fs::read(out.join("scene.ply")).expect("scene"),
        )
    };
    let (plenty, held, ply) = run(64, 2);
    assert_eq!(held, plenty.scene.views.len());
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
        frame["file_path"] = json!(format!("images/w{i}.png"));
        frame["split"] = json!("test");
        frames.push(frame);
    }
    fs::write(dir.join("transforms.json"), transforms.to_string()).expect("transforms");
    let mut config = plate_runs::config(dir);
    config.building.iterations = 2;
    config.segmentation.rows = Some(Vec::new());
    let outcome = plate_runs::whole(&config, &dir.join("run"));
    let mut names = Vec::new();
    let beside = |view: HeldOutView| {
        names.push(view.view.name.clone());
        Ok(())
    };
    let shown = held_out_views(&outcome, &crate::support::device(), beside).expect("views");
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
        ("one id", vec![7; 200_000], 4),
        ("blocks", (0..37_000).map(blocks).collect(), 1_000),
        ("noise", (0..1_000).map(noise).collect(), 1_000),
    ];
    for (name, ids, count) in cases {
        let map = LabelMap {
            width: ids.len() / 100,
            height: 100,
            ids,
        };
        let runs = LabelRuns::from(map.clone());
        assert_eq!(runs.runs().count(), count, "{name}");
        assert_eq!((runs.width(), runs.height()), (map.width, map.height));
        let unrolled: Vec<u16> = runs
            .runs()
            .flat_map(|(id, n)| std::iter::repeat_n(id, n))
            .collect();
        assert!(unrolled == map.ids && runs.map() == map, "{name}");
    }
}
