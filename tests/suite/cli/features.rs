//! `coseg render --features pca`: image features of a run as colours.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{cpu_backend, fails, read_npy, succeeds, utf8};
use coseg::data::{Split, read_cameras};
use coseg::features::FeatureColors;
use coseg::raster::{Settings, render};
use coseg::splat::ply;
use std::fs;
use std::path::{Path, PathBuf};

const COLORS: &str = "feature_colors.safetensors";

/// A short run of `variant` on the plates in `dir`.
fn run(dir: &Path, variant: &str) -> PathBuf {
    let run = dir.join("run");
    let rows = format!("segmentation.rows={variant}");
    let sets = [
        "building.iterations=20",
        "building.random_points=300",
        "segmentation.iterations=2",
        &rows,
    ];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let train = ["train", "--data", utf8(dir), "--out", utf8(&run)];
    let arguments: Vec<&str> = train.into_iter().chain(sets).collect();
    succeeds(&arguments);
    run
}

fn arguments<'a>(scene: &'a Path, out: &'a Path, more: &[&'a str]) -> Vec<&'a str> {
    let render = ["render", "--scene", utf8(scene), "--out", utf8(out)];
    let test = ["--split", "test"];
    [&render[..], &test, more].concat()
}

#[test]
fn features_are_rendered_in_the_colours_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = run(folder.path(), "ours");
    let [plain, with, arrays] = ["plain", "with", "arrays"].map(|name| folder.path().join(name));
    let backend = cpu_backend();
    let backend = ["--backend", &backend];
    let features = [&backend[..], &["--features", "pca"]].concat();
    succeeds(&arguments(&run, &plain, &backend));
    assert!(!plain.join("v2.features.png").exists());
    succeeds(&arguments(&run, &with, &features));
    for file in ["v2.rgb.png", "v5.alpha.png"] {
        let [a, b] = [&plain, &with].map(|out| fs::read(out.join(file)).unwrap());
        assert_eq!(a, b, "{file}");
    }
    let size = image::image_dimensions(with.join("v5.features.png")).unwrap();
    assert_eq!(size, (WIDTH as u32, HEIGHT as u32));

    succeeds(&arguments(
        &run,
        &arrays,
        &[&features[..], &["--format", "npy"]].concat(),
    ));
    let read = ply::read(&run.join("scene.ply")).unwrap();
    let colors = FeatureColors::read(&run.join(COLORS), read.gaussians.len()).unwrap();
    for channel in 0..3 {
        let values = colors.rgb.iter().map(|color| color[channel]);
        let (low, high) = values.fold((1.0_f32, 0.0_f32), |(l, h), v| (l.min(v), h.max(v)));
        assert_eq!((low, high), (0.0, 1.0), "channel {channel}");
    }
    let painted = read.gaussians.painted(&colors.rgb);
    let cameras = read_cameras(&run.join("cameras.json"), Some(Split::Test)).unwrap();
    let camera = cameras[0].camera.moved(-read.origin);
    let want = render(&painted, &camera, &Settings::default(), [0.0; 3]).unwrap();
    let (shape, found) = read_npy(&arrays.join("v2.features.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    assert_eq!(found, want.rgb);
    assert_ne!(found, read_npy(&arrays.join("v2.rgb.npy")).1);
}

#[test]
fn scenes_without_features_are_told_how_to_get_them() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = run(folder.path(), "ours");
    let out = folder.path().join("out");
    let refused = |scene: &Path, parts: &[&str]| {
        let more = ["--cameras", utf8(&run), "--features", "pca"];
        let message = fails(&arguments(scene, &out, &more), 1);
        for part in parts {
            assert!(message.contains(part), "{part}: {message}");
        }
        assert!(!out.exists(), "nothing is written");
    };
    let absent = ["--features", COLORS, "coseg train", "`ours`"];
    refused(&folder.path().join("plates.ply"), &absent);
    // Some Gaussians of the scene, beside its colours and elsewhere.
    let edited = |path: PathBuf| {
        let edit = ["edit", "--scene", utf8(&run), "--out", utf8(&path)];
        succeeds(&[&edit[..], &["--remove", "wall"]].concat());
        path
    };
    let elsewhere = edited(folder.path().join("edited/scene.ply"));
    refused(&elsewhere, &[&absent[..], &["coseg edit"]].concat());
    refused(
        &edited(run.join("edited.ply")),
        &[
            COLORS,
            "a colour for each Gaussian",
            "with its own scene.ply",
        ],
    );
    let whole = fs::read(run.join(COLORS)).unwrap();
    fs::write(run.join(COLORS), &whole[..whole.len() - 9]).unwrap();
    refused(&run, &[COLORS]);
    // A run that continues without image features drops what it had.
    let rows = ["--set", "segmentation.rows=vote"];
    succeeds(&[&["train", "--resume", utf8(&run)], &rows[..]].concat());
    assert!(!run.join(COLORS).exists());
    refused(&run, &absent);
    fails(&arguments(&run, &out, &["--features", "umap"]), 2);
}
