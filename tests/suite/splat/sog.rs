//! SOG files: what their texels mean, the labels beside them, and files that are refused.

use crate::files::mutations::survives;
use crate::support::rounding::worst;
use crate::support::sog::{meta, packed, parts, webp};
use coseg::splat::Gaussians;
use coseg::splat::formats::{self, sog};
use glam::DVec3;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

#[test]
fn the_texels_of_a_sog_file_mean_what_they_should() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.sog");
    fs::write(&path, packed(&parts())).expect("write");
    let scene = formats::read(&path).expect("readable");
    assert_eq!((scene.origin, scene.labels), (DVec3::ZERO, None));
    let g = scene.gaussians;
    let log = |v: f32| v.signum() * v.abs().exp_m1();
    let means = [[log(-1.0), log(2.0), 0.0], [log(1.0), 0.0, log(4.0)]];
    assert!(worst(g.means.as_flattened(), means.as_flattened()) < 1e-5);
    assert_eq!(g.log_scales, [[-5.0, -4.0, -3.0], [-2.0; 3]]);
    assert!((g.opacity_logits[0] - 0.25_f32.ln()).abs() < 1e-5);
    // y is the largest component. The bytes of the others are all or nothing, more than a unit quaternion has.
    let half = 0.5_f32.sqrt();
    let rotations = [[half, -half, 0.0, half], [1.0, 0.0, 0.0, 0.0]];
    assert!(worst(g.rotations.as_flattened(), rotations.as_flattened()) < 1e-5);
    assert_eq!(g.sh_degree, 1);
    let first = [
        0.5, -0.5, 0.0, 0.0, 1.0, 2.0, -1.0, -2.0, -3.0, 0.25, 0.5, 0.75,
    ];
    assert_eq!(g.sh[..12], first);
    assert_eq!(
        g.sh[12..],
        [[0.0; 3], [-32.0; 3], [-32.0; 3], [-32.0; 3]].concat()
    );
}

/// Gaussians in a row, two of each place, which differ in opacity.
fn pairs() -> Gaussians {
    let n = 100;
    Gaussians {
        means: (0..n)
            .map(|i| [(i / 2) as f32, 0.1 * i as f32, 0.0])
            .collect(),
        log_scales: vec![[-2.0; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: (0..n).map(|i| (i % 2) as f32).collect(),
        sh: vec![0.0; 3 * n],
        sh_degree: 0,
    }
}

/// A file of the `gaussians`, as a program may write it.
fn written(gaussians: &Gaussians) -> Vec<u8> {
    let log = |v: f32| f64::from(v.signum() * v.abs().ln_1p());
    let most = gaussians.means.as_flattened().iter().map(|&v| log(v));
    let most = most.fold(0.0, f64::max);
    let code = |mean: &[f32; 3]| mean.map(|v| ((65_535.0 * log(v) / most) as u16).to_le_bytes());
    let codes: Vec<[[u8; 2]; 3]> = gaussians.means.iter().map(code).collect();
    let byte = |k: usize| -> Vec<[u8; 4]> {
        codes
            .iter()
            .map(|c| [c[0][k], c[1][k], c[2][k], 255])
            .collect()
    };
    let opacity = |v: &f32| (255.0 / (1.0 + (-v).exp())).round() as u8;
    let opacities = gaussians.opacity_logits.iter();
    let colors: Vec<[u8; 4]> = opacities.map(|v| [128, 128, 128, opacity(v)]).collect();
    let n = gaussians.len();
    let mut meta = meta();
    meta["count"] = json!(n);
    meta["means"]["mins"] = json!([0.0, 0.0, 0.0]);
    meta["means"]["maxs"] = json!([most, most, most]);
    meta.as_object_mut().expect("a map").remove("shN");
    packed(&vec![
        ("meta.json", meta.to_string().into_bytes()),
        ("low.webp", webp(n, &byte(0))),
        ("high.webp", webp(n, &byte(1))),
        ("scales.webp", webp(n, &vec![[120, 120, 120, 255]; n])),
        ("quats.webp", webp(n, &vec![[128, 128, 128, 252]; n])),
        ("sh0.webp", webp(n, &colors)),
    ])
}

#[test]
fn labels_follow_the_rows_of_a_sog_file() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.sog");
    let scene = pairs();
    let labels: Vec<u16> = (0..100).collect();
    let order: Vec<u32> = (0..100).map(|i| i * 37 % 100).collect();
    fs::write(&path, written(&scene.select(&order))).expect("write");
    let want: Vec<u16> = order.iter().map(|&row| row as u16).collect();
    let found = sog::labels_of(&path, (&scene, DVec3::ZERO), &labels).expect("labels");
    assert_eq!(found, want);
    formats::write_labels_beside(&path, Some(found)).expect("write");
    assert_eq!(formats::read(&path).expect("readable").labels, Some(want));
    // Other Gaussians.
    let moved = (&scene, DVec3::new(0.5, 0.0, 0.0));
    let error = sog::labels_of(&path, moved, &labels).expect_err("refused");
    assert!(error.to_string().contains("another position"), "{error}");
}

/// The error of the file with the part `name` replaced.
fn refused(path: &Path, name: &'static str, bytes: Vec<u8>) -> String {
    let mut parts = parts();
    parts.retain(|(part, _)| *part != name);
    if !bytes.is_empty() {
        parts.push((name, bytes));
    }
    fs::write(path, packed(&parts)).expect("write");
    formats::read(path).expect_err("refused").to_string()
}

#[test]
fn damaged_sog_files_are_refused() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.sog");
    let with = |key: &str, value: Value| {
        let mut meta = meta();
        *meta.pointer_mut(key).expect("a value") = value;
        meta.to_string().into_bytes()
    };
    for (name, bytes, part) in [
        ("meta.json", Vec::new(), "meta.json"),
        ("meta.json", with("/version", json!(1)), "version"),
        (
            "meta.json",
            with("/count", json!(3)),
            "one for each of 3 Gaussians",
        ),
        ("meta.json", with("/count", json!(1_u64 << 40)), "points"),
        ("meta.json", with("/count", json!(1 << 27)), "Gaussians in"),
        (
            "meta.json",
            with("/sh0/codebook", json!([1.0])),
            "sh0.codebook",
        ),
        ("meta.json", with("/shN/bands", json!(4)), "shN.bands"),
        ("meta.json", with("/shN/bands", json!(2)), "columns"),
        (
            "meta.json",
            with("/means/maxs", json!([1e3, 1e3, 1e3])),
            "means",
        ),
        ("quats.webp", b"RIFF".to_vec(), "quats.webp"),
        (
            "labels.webp",
            webp(2, &[[64, 0, 0, 0]; 2]),
            "a row of the palette",
        ),
    ] {
        let message = refused(&path, name, bytes);
        assert!(
            message.contains(part) && message.contains("a.sog"),
            "{part}: {message}"
        );
    }
    fs::write(&path, b"no archive").expect("write");
    let message = formats::read(&path).expect_err("refused").to_string();
    assert!(message.contains("zip archive"), "{message}");
}

#[test]
fn mutations_of_a_sog_file_and_of_its_parts() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.sog");
    fs::write(&path, packed(&parts())).expect("write");
    survives(&path, formats::read);
    // The archive has checksums, which would catch nearly all of them.
    for name in [
        "meta.json",
        "low.webp",
        "quats.webp",
        "palette.webp",
        "labels.webp",
    ] {
        let mut parts = parts();
        let place = parts.iter().position(|(part, _)| *part == name);
        let place = place.expect("a part");
        let part = dir.path().join(name);
        fs::write(&part, &parts[place].1).expect("write");
        let parts = std::cell::RefCell::new(&mut parts);
        survives(&part, |part| {
            let mut parts = parts.borrow_mut();
            parts[place].1 = fs::read(part).expect("a part");
            fs::write(&path, packed(&parts)).expect("write");
            formats::read(&path)
        });
    }
}
