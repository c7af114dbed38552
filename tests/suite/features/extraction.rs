//! Feature extraction: the descriptor, the cache, the linear probe.

use crate::support::lifting::extract;
use crate::support::linear_probe::{ProbeScore, ProbeView, linear_probe};
use crate::support::pictures::{picture, pictures, scene, view};
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::{Classes, LabelMap, LoadOptions, Scene, Split, View, load};
use coseg::features::{FeatureMap, FeatureReduction, ViewFeatures, descriptor};
use image::RgbImage;
use std::path::Path;

fn descriptor_config() -> FeatureConfig {
    FeatureConfig {
        source: FeatureSource::Descriptor,
        scales: Some(4),
        ..FeatureConfig::default()
    }
}

#[test]
fn fewer_scales_are_the_finest_of_all() {
    let scene = pictures(4);
    let dir = tempfile::tempdir().expect("temporary folder");
    let views = |scales, cache_dir: Option<&Path>| {
        let config = FeatureConfig {
            scales,
            cache_dir: cache_dir.map(Path::to_owned),
            ..descriptor_config()
        };
        extract(&scene, &config, 0, &crate::support::device())
            .expect("descriptor")
            .views
    };
    let all = views(Some(4), None);
    for (scales, count) in [(None, 1), (Some(1), 1), (Some(3), 3), (Some(4), 4)] {
        // Maps of other scales in the cache are not taken for these.
        for (found, all) in views(scales, Some(dir.path())).iter().zip(&all) {
            assert_eq!(found.maps, all.maps[..count], "{scales:?}");
        }
    }
}

#[test]
fn the_source_decides_how_many_scales_there_are() {
    let count = |source, weights: Option<&str>, scales| {
        FeatureConfig {
            source,
            weights: weights.map(Into::into),
            scales,
            ..FeatureConfig::default()
        }
        .scale_count()
    };
    assert_eq!(count(FeatureSource::Auto, None, None), 1);
    assert_eq!(count(FeatureSource::Auto, Some("net"), None), 4);
    assert_eq!(count(FeatureSource::Dino, Some("net"), None), 4);
    assert_eq!(count(FeatureSource::Dino, Some("net"), Some(2)), 2);
    let tensor = FeatureSource::Segmenter("relu".to_owned());
    assert_eq!(count(tensor, Some("net"), None), 1);
    assert_eq!(count(FeatureSource::Descriptor, None, Some(4)), 4);
}

#[test]
fn descriptor_covers_any_image_size_with_finite_values() {
    const { assert!(descriptor::CHANNELS >= 64) };
    for (w, h) in [(1, 1), (3, 2), (5, 17), (64, 48), (70, 54)] {
        let maps = descriptor::describe(&picture(w, h, 1), 4);
        for (n, map) in maps.iter().enumerate() {
            map.check("descriptor").expect("finite");
            assert_eq!(map.channels, descriptor::CHANNELS);
            let step = [4, 4, 8, 16][n];
            assert_eq!(
                (map.width, map.height),
                (w.div_ceil(step) as usize, h.div_ceil(step) as usize),
                "{w}x{h} {n}"
            );
        }
    }
    let grey = descriptor::describe(&RgbImage::from_pixel(40, 40, image::Rgb([128; 3])), 4);
    for map in &grey {
        let first = map.cell(0, 0).to_vec();
        for cell in map.data.chunks_exact(map.channels) {
            assert!(
                cell.iter().zip(&first).all(|(a, b)| (a - b).abs() < 1e-4),
                "a flat picture has one descriptor"
            );
        }
    }
}

#[test]
fn descriptor_knows_no_position() {
    // Shifting the picture by whole cells shifts the maps: compare cells far from the border.
    let big = picture(256, 192, 3);
    let crop = |x: u32| image::imageops::crop_imm(&big, x, 0, 192, 192).to_image();
    let (a, b) = (
        descriptor::describe(&crop(0), 1),
        descriptor::describe(&crop(16), 1),
    );
    let (a, b) = (&a[0], &b[0]);
    for y in 16..32 {
        for x in 16..28 {
            let difference = a
                .cell(x + 4, y)
                .iter()
                .zip(b.cell(x, y))
                .map(|(p, q)| (p - q).abs())
                .fold(0.0, f32::max);
            assert!(difference < 2e-3, "cell {x} {y}: {difference}");
        }
    }
}

#[test]
fn extraction_reduces_every_view_and_fits_on_training_views_only() {
    let mut scene = pictures(8);
    let config = descriptor_config();
    let set = extract(&scene, &config, 1, &crate::support::device()).expect("maps");
    let (train, test) = extract_with_tests(&scene, &config, 1);
    assert_eq!(set.name, "descriptor");
    assert_eq!((train.len(), test.len()), (6, 2));
    assert_eq!(set.views, train);
    for view in train.iter().chain(&test) {
        for map in &view.maps {
            assert_eq!(map.channels, 64);
            for cell in map.data.chunks_exact(64) {
                assert!((cell.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-4);
            }
        }
    }
    for view in scene.views.iter_mut().filter(|v| v.split == Split::Test) {
        view.image = RgbImage::from_pixel(70, 54, image::Rgb([250, 0, 0])).into();
    }
    let other = extract(&scene, &config, 1, &crate::support::device()).expect("maps");
    assert_eq!(
        set.reductions, other.reductions,
        "test views must not enter the fit"
    );
    assert_eq!(set.views, other.views);
}

/// Reduced maps of the training views and of the test views.
fn extract_with_tests(
    scene: &Scene,
    config: &FeatureConfig,
    seed: u64,
) -> (Vec<ViewFeatures>, Vec<ViewFeatures>) {
    let device = crate::support::device();
    let reduction = FeatureReduction::fit(scene, config, seed, &device, &mut || Ok(()));
    let mut reduction = reduction.expect("maps");
    let train: Vec<_> = reduction
        .training_views()
        .map(|v| v.expect("maps"))
        .collect();
    let test: Vec<&View> = scene.split(Split::Test).collect();
    let test = reduction.views(&test).map(|v| v.expect("maps")).collect();
    (train, test)
}

#[test]
fn extraction_gives_the_same_bits_at_one_and_two_threads() {
    let scene = pictures(9);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            extract(&scene, &descriptor_config(), 5, &crate::support::device())
                .expect("descriptor")
                .views
        })
    };
    assert!(with(1) == with(2));
}

#[test]
fn unusable_settings_are_named() {
    let scene = pictures(3);
    let error = |config: &FeatureConfig| {
        extract(&scene, config, 0, &crate::support::device())
            .expect_err("unusable")
            .to_string()
    };
    assert!(
        error(&FeatureConfig {
            dimensions: 0,
            ..descriptor_config()
        })
        .contains("features.dimensions")
    );
    let import = FeatureConfig {
        source: FeatureSource::Import("/nowhere/maps".into()),
        ..FeatureConfig::default()
    };
    assert!(error(&import).contains("/nowhere/maps"));
    let mobilenet = FeatureConfig {
        source: FeatureSource::Mobilenetv2,
        ..FeatureConfig::default()
    };
    assert!(error(&mobilenet).contains("features.weights"));
    let mut empty = pictures(3);
    empty.views.clear();
    assert!(
        extract(&empty, &descriptor_config(), 0, &crate::support::device())
            .expect_err("no view")
            .to_string()
            .contains("training view")
    );
}

#[test]
fn the_cache_is_used_and_damaged_entries_are_computed_again() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let scene = pictures(4);
    let config = FeatureConfig {
        cache_dir: Some(dir.path().join("cache")),
        ..descriptor_config()
    };
    let run = || {
        extract(&scene, &config, 0, &crate::support::device())
            .expect("descriptor")
            .views
    };
    let fresh = run();
    let entries = || -> Vec<_> {
        let mut paths: Vec<_> = std::fs::read_dir(dir.path().join("cache"))
            .expect("cache")
            .map(|e| e.expect("entry").path())
            .collect();
        paths.sort();
        paths
    };
    let paths = entries();
    assert_eq!(
        paths.len(),
        3,
        "one entry a training view, no temporary left"
    );
    assert!(run() == fresh, "cached maps are the computed ones");
    let plain = extract(&scene, &descriptor_config(), 0, &crate::support::device())
        .expect("descriptor")
        .views;
    assert!(plain == fresh);
    // A flipped bit, a cut file and rubbish: computed again, and written again.
    let whole: Vec<Vec<u8>> = paths
        .iter()
        .map(|p| std::fs::read(p).expect("entry"))
        .collect();
    let mut flipped = whole[0].clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    std::fs::write(&paths[0], flipped).expect("write");
    std::fs::write(&paths[1], &whole[1][..whole[1].len() / 3]).expect("write");
    std::fs::write(&paths[2], b"rubbish").expect("write");
    assert!(run() == fresh);
    for (path, whole) in paths.iter().zip(&whole) {
        assert!(
            std::fs::read(path).expect("entry") == *whole,
            "the entry is whole again"
        );
    }
    assert_eq!(entries(), paths);
}

#[test]
fn a_used_cache_entry_is_read_not_computed() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let one = scene(
        vec![view("a", Split::Train, picture(64, 48, 1), None)],
        Classes::default(),
    );
    let config = FeatureConfig {
        cache_dir: Some(dir.path().to_owned()),
        ..descriptor_config()
    };
    extract(&one, &config, 0, &crate::support::device()).expect("descriptor");
    let other = scene(
        vec![view("b", Split::Train, picture(64, 48, 2), None)],
        Classes::default(),
    );
    let expected = extract(&other, &config, 0, &crate::support::device()).expect("descriptor");
    // Put the entry of `b` where that of `a` is expected: if it is read, `a` looks like `b`.
    let mut paths: Vec<_> = std::fs::read_dir(dir.path())
        .expect("cache")
        .map(|e| e.expect("entry").path())
        .collect();
    paths.sort_by_key(|p| {
        std::fs::metadata(p)
            .and_then(|m| m.modified())
            .expect("time")
    });
    std::fs::copy(&paths[1], &paths[0]).expect("copy");
    let read = extract(&one, &config, 0, &crate::support::device()).expect("descriptor");
    assert!(read.views[0].maps == expected.views[0].maps);
}

fn probe_of(scene: &Scene, train: &[ViewFeatures], test: &[ViewFeatures]) -> ProbeScore {
    fn views<'a>(truth: &'a [LabelMap], features: &'a [ViewFeatures]) -> Vec<ProbeView<'a>> {
        truth
            .iter()
            .zip(features)
            .map(|(truth, f)| ProbeView {
                truth,
                maps: &f.maps,
            })
            .collect()
    }
    let truth = |split| {
        scene
            .split(split)
            .map(|v| v.truth.as_ref().expect("truth").map())
            .collect::<Vec<_>>()
    };
    let truth = [truth(Split::Train), truth(Split::Test)];
    let (train, test) = (views(&truth[0], train), views(&truth[1], test));
    linear_probe(&scene.classes, &train, &test)
}

fn rgb_maps(scene: &Scene, split: Split) -> Vec<ViewFeatures> {
    let map = |v: &View| FeatureMap {
        height: v.image.height(),
        width: v.image.width(),
        channels: 3,
        data: v.rgb().expect("photo"),
        steps: None,
    };
    scene
        .split(split)
        .map(|v| ViewFeatures {
            view: v.name.clone(),
            maps: vec![map(v)],
        })
        .collect()
}

#[test]
fn descriptor_beats_raw_colour_in_the_linear_probe() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let mut scene =
        load(&shared.join("data/house_living"), &LoadOptions::default()).expect("scene");
    let mut count = 0;
    scene.views.retain(|_| {
        count += 1;
        count % 5 == 0
    });
    let rgb = probe_of(
        &scene,
        &rgb_maps(&scene, Split::Train),
        &rgb_maps(&scene, Split::Test),
    );
    eprintln!("raw colour: {rgb:?}");
    let config = descriptor_config();
    let (set, test) = extract_with_tests(&scene, &config, 0);
    let ours = probe_of(&scene, &set, &test);
    eprintln!("descriptor: {ours:?}");
    assert!(ours.accuracy > rgb.accuracy + 0.2 && ours.miou > rgb.miou + 0.3);
}
