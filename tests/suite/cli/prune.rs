//! `coseg prune` on plates with Gaussians that no photo shows.

use crate::support::plates::{plates, scene};
use crate::support::program::{fails, listed, succeeds, utf8};
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use std::path::Path;

/// Gaussians behind the cameras, a third of the scene.
const HIDDEN: usize = 55;

/// The plates and [`HIDDEN`] Gaussians of label 9 in front of them in the file; returns those of the plates.
fn with_hidden(path: &Path) -> Gaussians {
    let (plates, labels) = plates();
    let rows: Vec<u32> = (0..HIDDEN as u32).chain(0..plates.len() as u32).collect();
    let mut all = plates.select(&rows);
    all.means[..HIDDEN].fill([0.0, 0.0, 50.0]);
    let labels: Vec<u16> = std::iter::repeat_n(9, HIDDEN).chain(labels).collect();
    ply::write(path, &all, DVec3::ZERO, Some(&labels)).unwrap();
    plates
}

#[test]
fn what_no_photo_shows_goes_and_the_rest_keeps_its_labels() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    scene(&path("data"));
    let plates = with_hidden(&path("scene.ply"));
    let prune = |option: &[&str], out: &str| {
        let arguments = [
            "prune",
            "--scene",
            utf8(&path("scene.ply")),
            "--data",
            utf8(&path("data")),
            "--out",
            utf8(&path(out)),
        ]
        .map(str::to_owned);
        let option = option.iter().map(|&word| word.to_owned());
        let arguments: Vec<String> = arguments.into_iter().chain(option).collect();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let said = succeeds(&arguments);
        let read = ply::read(&path(out).join("scene.ply")).unwrap();
        (said, read)
    };
    let share = plates.len() as f64 / (plates.len() + HIDDEN) as f64;
    let (said, kept) = prune(&["--keep", &share.to_string()], "shown");
    assert!(said.contains("111 of 166 Gaussians"), "{said}");
    assert_eq!(kept.gaussians.len(), plates.len());
    assert_eq!(kept.labels.unwrap(), crate::support::plates::plates().1);
    assert!(path("shown/cameras.json").is_file());
    let (_, exact) = prune(&["--within", "0"], "exact");
    let left = exact.gaussians.len();
    assert!(
        (plates.len() - 1..=plates.len() + 5).contains(&left),
        "{left}"
    );
    let (said, few) = prune(&["--within", "6dB"], "few");
    assert!(few.gaussians.len() < left, "{said}");
    assert!(said.contains("held-out views: PSNR"), "{said}");
}

#[test]
fn numbers_out_of_range_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let file = folder.path().join("scene.ply");
    scene(&data);
    with_hidden(&file);
    let out = folder.path().join("out");
    let start = [
        "prune",
        "--scene",
        utf8(&file),
        "--data",
        utf8(&data),
        "--out",
        utf8(&out),
    ];
    for (option, value) in [
        ("--keep", "0"),
        ("--keep", "-1"),
        ("--keep", "1.5"),
        ("--keep", "NaN"),
        ("--within", "inf"),
    ] {
        let message = fails(&[&start[..], &[option, value]].concat(), 1);
        assert!(
            message.contains(option) && message.contains("expected"),
            "{message}"
        );
    }
    fails(&start, 2);
    fails(
        &[&start[..], &["--keep", "0.5", "--within", "1"]].concat(),
        2,
    );
    let out = folder.path().join("small.ply");
    let message = fails(&[&start[..6], &[utf8(&out), "--keep", "0.5"]].concat(), 1);
    assert!(message.contains("expected a folder"), "{message}");
    assert_eq!(
        listed(folder.path()),
        ["data", "scene.ply"],
        "nothing is written"
    );
}
