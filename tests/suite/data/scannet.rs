//! ScanNet as its exporter writes it, small.

use crate::support::scannet::{FRAMES, scene};
use coseg::config::{Layout, ScannetClasses};
use coseg::data::{LabelMap, LoadOptions, Split, check, load, locate};
use std::fs;
use std::path::Path;

#[track_caller]
fn expect_error(dir: &Path, parts: &[&str]) {
    crate::support::assert_names(
        &load(dir, &LoadOptions::default()).expect_err("an error"),
        parts,
    );
}

#[test]
fn scannet_scenes_load() {
    let dir = scene();
    let options = LoadOptions::default();
    assert_eq!(
        locate(dir.path(), &options).expect("layout"),
        Layout::Scannet
    );
    let scene = load(dir.path(), &options).expect("scene");
    let names: Vec<_> = scene.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(
        names,
        ["0", "1", "2", "3", "5", "6", "8", "9", "10", "11"],
        "by number, lost ones left out"
    );
    let tests: Vec<_> = scene.split(Split::Test).map(|v| v.name.as_str()).collect();
    assert_eq!(tests, ["0", "10"]);
    let checked = check(dir.path(), &options);
    assert!(
        checked.problems.is_empty() && checked.notices.len() == 1,
        "{checked:?}"
    );
    assert!(
        checked.notices[0].starts_with("2 of 12 frames left out"),
        "{checked:?}"
    );
    let c = &scene.views[4].camera;
    assert_eq!(
        (c.fx, c.fy, c.cx, c.cy, c.width, c.height),
        (60.0, 61.0, 31.0, 23.0, 64, 48)
    );
    let center = c.center + scene.origin;
    assert!(
        (center - glam::DVec3::new(5.0, 0.5, 1.5)).length() < 1e-12,
        "{center}"
    );
    assert_eq!(scene.up, glam::DVec3::Z);
    let classes: Vec<_> = scene
        .classes
        .entries
        .iter()
        .map(|c| (c.id, c.name.as_str()))
        .collect();
    assert_eq!(classes, [(1, "wall"), (40, "otherprop")]);
    let point = scene.points.positions[0].map(f64::from);
    let seen = scene.views[3].camera.to_camera(glam::DVec3::from(point));
    assert!(
        scene.points.len() == 48 && (seen.z - 3.0).abs() < 1e-5,
        "{seen}"
    );
    let (u, v, _) = scene.views[3]
        .camera
        .project(point.into())
        .expect("in front");
    assert!(
        (u - 4.0).abs() < 1e-4 && (v - 4.0).abs() < 1e-4,
        "the middle of the first depth pixel: {u} {v}"
    );
    // Label maps of half the size are resampled without blending.
    let truth = scene.views[0].truth.as_ref().expect("truth").map();
    assert_eq!((truth.width, truth.height), (64, 48));
    assert_eq!(
        [0, 63, 24 * 64, 24 * 64 + 31, 24 * 64 + 32, 48 * 64 - 1].map(|i| truth.ids[i]),
        [1, 1, 0, 0, 40, 40]
    );
    // The 20 classes of the benchmark leave the other ids unlabelled.
    let options = LoadOptions {
        scannet_classes: ScannetClasses::Scannet20,
        max_frames: 4,
        ..options
    };
    let scene = load(dir.path(), &options).expect("scene");
    assert_eq!(
        (
            scene.views.len(),
            scene.classes.len(),
            scene.classes.entries[0].id
        ),
        (4, 1, 1)
    );
    assert_eq!(
        scene.views[0].truth.as_ref().expect("truth").map().ids[48 * 64 - 1],
        0
    );
    fs::remove_file(dir.path().join("scannetv2-labels.combined.tsv")).expect("remove");
    expect_error(
        dir.path(),
        &[
            "scannetv2-labels.combined.tsv",
            "no such file",
            "copy it from the dataset",
        ],
    );
    // Without labels no table is needed.
    fs::remove_dir_all(dir.path().join("label-filt")).expect("remove");
    assert!(
        load(dir.path(), &LoadOptions::default())
            .expect("scene")
            .classes
            .is_empty()
    );
}

#[test]
fn broken_scannet_scenes_are_refused_by_name() {
    let dir = scene();
    let at = |p: &str| dir.path().join(p);
    let whole = |p: &str| fs::read(at(p)).expect("read");
    let cases: [(&str, &[u8], &[&str]); 9] = [
        (
            "pose/3.txt",
            b"1 0 0",
            &["3.txt", "3 numbers", "16 numbers"],
        ),
        (
            "pose/3.txt",
            b"2 0 0 1 0 2 0 1 0 0 2 1 0 0 0 1",
            &["3.txt", "rotation"],
        ),
        (
            "pose/3.txt",
            b"1 0 0 1 0 1 0 1 0 0 1 1 0 0 1 1",
            &["3.txt", "last row"],
        ),
        (
            "intrinsic/intrinsic_color.txt",
            b"60 0 640 0 0 61 480 0 0 0 1 0 0 0 0 1",
            &["intrinsic_color.txt", "640 480", "64x48"],
        ),
        (
            "intrinsic/intrinsic_color.txt",
            b"0 0 31 0 0 61 23 0 0 0 1 0 0 0 0 1",
            &["intrinsic_color.txt", "focal length", "0 61"],
        ),
        (
            "scannetv2-labels.combined.tsv",
            b"id\tname\n1\twall\n",
            &["tsv", "line 1", "nyu40id"],
        ),
        (
            "scannetv2-labels.combined.tsv",
            b"id\tnyu40id\n1\tx\n",
            &["tsv", "line 2", "\"x\""],
        ),
        (
            "scannetv2-labels.combined.tsv",
            b"id\tnyu40id\n1\t41\n",
            &["tsv", "line 2", "41"],
        ),
        (
            "scannetv2-labels.combined.tsv",
            b"id\tnyu40id\n1\t1\n",
            &["0.png", "label id 1163", "table"],
        ),
    ];
    for (file, content, parts) in cases {
        let before = whole(file);
        fs::write(at(file), content).expect("write");
        expect_error(dir.path(), parts);
        fs::write(at(file), before).expect("write");
    }
    let map = whole("label-filt/2.png");
    LabelMap {
        width: 24,
        height: 32,
        ids: vec![1; 768],
    }
    .write(&at("label-filt/2.png"))
    .expect("labels");
    expect_error(dir.path(), &["label-filt/2.png", "24x32", "64x48"]);
    fs::write(at("label-filt/2.png"), map).expect("write");
    fs::remove_file(at("pose/9.txt")).expect("remove");
    expect_error(dir.path(), &["pose/9.txt", "no such file"]);
    for i in 0..FRAMES {
        fs::write(at(&format!("pose/{i}.txt")), "inf ".repeat(16)).expect("write");
    }
    expect_error(
        dir.path(),
        &["color", "12 photos, 12 of them without a finite pose"],
    );
}
