//! Feature extraction: the descriptor, the cache, imported maps, the linear probe.

use crate::support::lifting::extract;
use crate::support::linear_probe::{ProbeScore, ProbeView, linear_probe};
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::formats::transforms;
use coseg::data::formats::transforms::LoadOptions;
use coseg::data::{Classes, LabelMap, LabelRuns, Photo, Points, Scene, Split, View};
use coseg::features::{FeatureMap, Reduction, ViewFeatures, descriptor};
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use image::RgbImage;
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::Path;

fn camera(width: usize, height: usize) -> Camera {
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    Camera {
        rotation: DMat3::IDENTITY,
        center: DVec3::ZERO,
        fx: 300.0,
        fy: 300.0,
        cx,
        cy,
        width,
        height,
    }
}

fn view(name: &str, split: Split, image: RgbImage, truth: Option<LabelMap>) -> View {
    let (image, truth) = (Photo::from(image), truth.map(LabelRuns::from));
    let camera = camera(image.width(), image.height());
    View {
        name: name.into(),
        split,
        camera,
        image,
        mask: None,
        truth,
        raw: None,
        scores: None,
        segments: Vec::new(),
        instances: None,
    }
}

fn scene(views: Vec<View>, classes: Classes) -> Scene {
    Scene {
        name: "test".into(),
        views,
        classes,
        points: Points::default(),
        drawn: false,
        origin: DVec3::ZERO,
        up: DVec3::Z,
    }
}

/// Coloured noise over a gradient; `seed` moves it.
fn picture(width: u32, height: u32, seed: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let n = (x.wrapping_mul(73) ^ y.wrapping_mul(151) ^ seed.wrapping_mul(977))
            .wrapping_mul(2_654_435_761)
            >> 24;
        image::Rgb([
            (x * 255 / width) as u8,
            (n / 2 + y * 100 / height) as u8,
            ((x / 7 + y / 5 + seed) % 2 * 180) as u8,
        ])
    })
}

fn pictures(count: u32) -> Scene {
    let views = (0..count).map(|i| {
        view(
            &format!("v{i}"),
            if i % 4 == 3 {
                Split::Test
            } else {
                Split::Train
            },
            picture(70, 54, i),
            None,
        )
    });
    scene(views.collect(), Classes::default())
}

fn descriptor_config() -> FeatureConfig {
    FeatureConfig {
        source: FeatureSource::Descriptor,
        ..FeatureConfig::default()
    }
}

#[test]
fn descriptor_covers_any_image_size_with_finite_values() {
    const { assert!(descriptor::CHANNELS >= 64) };
    for (w, h) in [(1, 1), (3, 2), (5, 17), (64, 48), (70, 54)] {
        let maps = descriptor::describe(&picture(w, h, 1));
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
    let grey = descriptor::describe(&RgbImage::from_pixel(40, 40, image::Rgb([128; 3])));
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
        descriptor::describe(&crop(0)),
        descriptor::describe(&crop(16)),
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
    let go_on = &mut || ControlFlow::<Infallible>::Continue(());
    let device = crate::support::device();
    let ControlFlow::Continue(mut reduction) =
        Reduction::fit(scene, config, seed, &device, go_on).expect("maps");
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
fn cache_is_used_and_damage_is_mended() {
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

fn write_npy(path: &Path, shape: &[u64], values: &[f32]) {
    use npyz::WriterBuilder;
    let file = std::fs::File::create(path).expect("create");
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(shape)
        .writer(file)
        .begin_nd()
        .expect("header");
    writer.extend(values.iter().copied()).expect("values");
    writer.finish().expect("finish");
}

fn ramp(count: usize, seed: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 37 + seed * 101) % 997) as f32 / 997.0)
        .collect()
}

#[test]
fn maps_are_imported_from_npy_and_safetensors() {
    use safetensors::tensor::{Dtype, TensorView};
    let dir = tempfile::tempdir().expect("temporary folder");
    let scene = pictures(3);
    let shapes = [[12_usize, 16, 5], [12, 16, 6], [6, 8, 7], [3, 4, 80]];
    let values: Vec<Vec<f32>> = (0..4)
        .map(|n| ramp(shapes[n].iter().product(), n))
        .collect();
    for stem in ["v0", "v1"] {
        for n in 0..4 {
            write_npy(
                &dir.path().join(format!("{stem}.{}.npy", n + 1)),
                &shapes[n].map(|x| x as u64),
                &values[n],
            );
        }
    }
    // The third view in half precision.
    let bytes: Vec<Vec<u8>> = values
        .iter()
        .map(|v| {
            v.iter()
                .flat_map(|&x| half::f16::from_f32(x).to_le_bytes())
                .collect()
        })
        .collect();
    let tensors = (0..4).map(|n| {
        (
            format!("scale{}", n + 1),
            TensorView::new(Dtype::F16, shapes[n].to_vec(), &bytes[n]).expect("view"),
        )
    });
    std::fs::write(
        dir.path().join("v2.safetensors"),
        safetensors::serialize(tensors, None).expect("serialize"),
    )
    .expect("write");
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let set = extract(&scene, &config, 0, &crate::support::device()).expect("imported");
    assert_eq!(set.name, format!("imported {}", dir.path().display()));
    for (n, [h, w, _]) in shapes.into_iter().enumerate() {
        let map = &set.views[0].maps[n];
        assert_eq!((map.height, map.width, map.channels), (h, w, 64));
        assert!(set.views[0].maps[n] == set.views[1].maps[n]);
        let difference = map
            .data
            .iter()
            .zip(&set.views[2].maps[n].data)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(difference < 2e-2, "half precision: {difference}");
    }
    assert!(
        set.views[0].maps[0]
            .data
            .chunks_exact(64)
            .all(|c| c[5..].iter().all(|&x| x == 0.0)),
        "5 channels, padded"
    );
}

/// An npy file of version 1 with this header and these bytes.
fn npy(descr: &str, fortran: bool, shape: &str, bytes: Vec<u8>) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({shape}), }}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((text.len() as u16).to_le_bytes());
    file.extend(text.bytes());
    file.extend(bytes);
    file
}

#[test]
fn npy_maps_of_any_order_and_float_are_the_same() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let one = scene(
        vec![view("a", Split::Train, picture(16, 16, 0), None)],
        Classes::default(),
    );
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let (height, width, channels) = (3, 4, 2);
    // Numbers that half precision holds exactly.
    let value = |y: usize, x: usize, c: usize| ((y * 5 + x * x * 3 + c * 7) % 13) as f32 - 4.5;
    let mut row_major = Vec::new();
    for y in 0..height {
        for x in 0..width {
            row_major.extend((0..channels).map(|c| value(y, x, c)));
        }
    }
    let mut column_major = Vec::new();
    for c in 0..channels {
        for x in 0..width {
            column_major.extend((0..height).map(|y| value(y, x, c)));
        }
    }
    let shape = format!("{height}, {width}, {channels}");
    let maps = |descr: &str, fortran: bool, bytes: Vec<u8>| {
        for n in 1..=4 {
            let file = npy(descr, fortran, &shape, bytes.clone());
            std::fs::write(dir.path().join(format!("a.{n}.npy")), file).expect("write");
        }
        extract(&one, &config, 0, &crate::support::device())
    };
    fn bytes<const N: usize>(values: &[f32], to: impl Fn(f32) -> [u8; N]) -> Vec<u8> {
        values.iter().flat_map(|&v| to(v)).collect()
    }
    let plain = maps("<f4", false, bytes(&row_major, f32::to_le_bytes)).expect("maps");
    let half = |v: f32| half::f16::from_f32(v);
    for (descr, fortran, bytes) in [
        (">f4", false, bytes(&row_major, f32::to_be_bytes)),
        ("<f2", false, bytes(&row_major, |v| half(v).to_le_bytes())),
        (">f2", false, bytes(&row_major, |v| half(v).to_be_bytes())),
        ("<f4", true, bytes(&column_major, f32::to_le_bytes)),
    ] {
        let found = maps(descr, fortran, bytes).expect("maps");
        assert!(found.views == plain.views, "{descr} {fortran}");
    }
    let error = maps("<f8", false, vec![0; 8 * 24]).expect_err("f64");
    crate::support::assert_names(&error, &["a.1.npy", "dtype", "f8"]);
}

#[test]
fn hostile_maps_are_refused_by_name() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let one = scene(
        vec![view("a", Split::Train, picture(16, 16, 0), None)],
        Classes::default(),
    );
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let file = |n: usize| dir.path().join(format!("a.{n}.npy"));
    let good = || (1..=4).for_each(|n| write_npy(&file(n), &[2, 3, 4], &ramp(24, n)));
    let error = || {
        extract(&one, &config, 0, &crate::support::device())
            .expect_err("hostile")
            .to_string()
    };
    assert!(error().contains("view a, scale 1"), "absent");
    good();
    extract(&one, &config, 0, &crate::support::device()).expect("good maps");
    let bytes = std::fs::read(file(3)).expect("map");
    for cut in [0, 5, 9, 40, bytes.len() - 3] {
        std::fs::write(file(3), &bytes[..cut]).expect("write");
        assert!(error().contains("a.3.npy"), "cut at {cut}: {}", error());
    }
    good();
    let mut nan = ramp(24, 1);
    nan[13] = f32::NAN;
    write_npy(&file(2), &[2, 3, 4], &nan);
    assert!(
        error().contains("a.2.npy") && error().contains("row 3"),
        "{}",
        error()
    );
    good();
    write_npy(&file(2), &[6, 4], &ramp(24, 1));
    assert!(error().contains("shape"), "{}", error());
    write_npy(&file(2), &[0, 3, 4], &[]);
    assert!(error().contains("shape"), "{}", error());
    // A header that promises petabytes, and one longer than the file.
    let text = b"{'descr': '<f4', 'fortran_order': False, 'shape': (900000, 900000, 64), }\n";
    let mut huge = b"\x93NUMPY\x01\x00".to_vec();
    huge.extend((text.len() as u16).to_le_bytes());
    huge.extend(text);
    std::fs::write(file(2), &huge).expect("write");
    assert!(error().contains("a.2.npy"), "{}", error());
    std::fs::write(file(2), b"\x93NUMPY\x02\x00\xff\xff\xff\xffabc").expect("write");
    assert!(error().contains("header"), "{}", error());
    good();
    std::fs::write(
        dir.path().join("a.safetensors"),
        b"\xff\xff\xff\xff\xff\xff\xff\x7f{}",
    )
    .expect("write");
    assert!(error().contains("a.safetensors"), "{}", error());
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
            maps: [
                map(v),
                FeatureMap::default(),
                FeatureMap::default(),
                FeatureMap::default(),
            ],
        })
        .collect()
}

#[test]
fn descriptor_beats_raw_colour_in_the_linear_probe() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let mut scene = transforms::load(&shared.join("data/house_living"), &LoadOptions::default())
        .expect("scene");
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
