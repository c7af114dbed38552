//! The program splat-transform reads what this one writes, and the other way round.

use crate::support::glb::parsed;
use crate::support::program::{text, utf8};
use crate::support::rounding::{errors, gaussians};
use crate::support::skip_without_program;
use coseg::data::Classes;
use coseg::splat::Gaussians;
use coseg::splat::formats::{self, Format};
use coseg::splat::ply::{self, PlyScene};
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Converts a file; `false` without the program.
fn convert(from: &Path, to: &Path, options: &[&str]) -> bool {
    let mut program = Command::new("splat-transform");
    program.args(["--quiet", "--overwrite"]).args(options);
    program.stderr(Stdio::null());
    program
        .args([from, to])
        .status()
        .is_ok_and(|status| status.success())
}

fn read(path: &Path) -> Gaussians {
    let scene = formats::read(path).expect("readable");
    assert_eq!(scene.origin, DVec3::ZERO);
    scene.gaussians
}

/// Whether there is a splat-transform whose `.spz` files are not turned, as version 2 turns them.
fn is_there() -> bool {
    let version = Command::new("splat-transform").arg("--version").output();
    let said = |output: std::process::Output| text(&[output.stdout, output.stderr].concat());
    let version = version.map(said).unwrap_or_default();
    let is_there = !version.is_empty() && !version.starts_with("splat-transform v2.");
    if !is_there {
        skip_without_program("splat-transform 3 or later is not on the PATH");
    }
    is_there
}

/// The scene that COSEG_SCENE names, or made-up Gaussians.
fn scene() -> (Gaussians, DVec3) {
    match std::env::var_os("COSEG_SCENE") {
        Some(path) => {
            let scene = ply::read(path.as_ref()).expect("a scene");
            (scene.gaussians, scene.origin)
        }
        None => (gaussians(3_000, 3), DVec3::ZERO),
    }
}

/// The Gaussians in world units.
fn in_world(scene: &Gaussians, origin: DVec3) -> Gaussians {
    let position = |mean: &[f32; 3]| DVec3::from(mean.map(f64::from)) + origin;
    let means = scene.means.iter().map(position);
    Gaussians {
        means: means.map(|p| p.as_vec3().to_array()).collect(),
        ..scene.clone()
    }
}

/// Prints the errors of a format.
fn print(name: &str, errors: &[f32; 6]) {
    println!("{name}");
    let what = [
        "position",
        "log-scale",
        "opacity",
        "colour",
        "SH",
        "rotation in degrees",
    ];
    for (what, error) in what.iter().zip(errors) {
        println!("  {what}: at most {error:.2e}");
    }
}

/// COSEG_SCENE names a scene whose errors are printed instead of those of made-up Gaussians.
#[test]
fn splat_transform_reads_and_writes_the_same_values() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let (scene, origin) = scene();
    ply::write(&at("scene.ply"), &scene, origin, None).expect("write");
    let ordered = in_world(&scene.select(&scene.spatial_order()), origin);
    for (name, format, options) in [
        ("a.spz", Format::Spz, &["--spz-version", "3"][..]),
        ("a.spz", Format::Spz, &["--spz-version", "4"]),
        ("a.compressed.ply", Format::CompressedPly, &[]),
    ] {
        formats::write(&at(name), format, &scene, origin, None).expect("write");
        assert!(convert(&at(name), &at("ours.ply"), &[]));
        let theirs = read(&at("ours.ply"));
        let differences = errors(&theirs, &read(&at(name)));
        print(name, &errors(&theirs, &ordered));
        // Written by splat-transform, read by both.
        let other = at(&format!("other{}", &name[1..]));
        assert!(convert(&at("scene.ply"), &other, options));
        assert!(convert(&other, &at("theirs.ply"), &[]));
        let others = errors(&read(&at("theirs.ply")), &read(&other));
        for differences in [differences, others] {
            let [position, scale, opacity, color, sh, degrees] = differences;
            let most = [position, scale, opacity, color, sh]
                .into_iter()
                .fold(0.0, f32::max);
            assert!(most < 2e-5 && degrees < 0.05, "{name}: {differences:?}");
        }
    }
}

/// The file that `coseg export` makes of the scene, with labels that number its rows, as far as 16 bits do.
fn exported(dir: &Path, name: &str) -> (PlyScene, PathBuf) {
    let (gaussians, origin) = scene();
    let labels: Vec<u16> = (0..gaussians.len()).map(|row| row as u16).collect();
    let from = dir.join("scene.ply");
    ply::write(&from, &gaussians, origin, Some(&labels)).expect("write");
    let classes = (0..=u16::MAX).map(|id| (id, format!("row {id}")));
    let classes = Classes::from_names(u16::MAX, classes);
    classes.write(&dir.join("classes.json")).expect("write");
    let to = dir.join(name);
    let mut command = Command::new(env!("CARGO_BIN_EXE_coseg"));
    let output = command
        .args(["export", "--scene", utf8(&from), "--out", utf8(&to)])
        .output()
        .expect("run");
    let message = text(&output.stderr);
    assert!(
        output.status.success() && !message.contains("no labels"),
        "{message}"
    );
    let scene = PlyScene {
        gaussians,
        origin,
        labels: Some(labels),
    };
    (scene, to)
}

#[test]
fn a_sog_file_gets_its_values_and_labels_back() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().expect("folder");
    let (scene, path) = exported(dir.path(), "a.sog");
    let found = formats::read(&path).expect("readable");
    let labels = found.labels.expect("labels");
    // Each label is a row.
    let rows: Vec<u32> = labels.iter().map(|&label| u32::from(label)).collect();
    let mut all = rows.clone();
    all.sort_unstable();
    assert!(
        all.iter().copied().eq(0..rows.len() as u32),
        "each row once"
    );
    let expected = in_world(&scene.gaussians, scene.origin).select(&rows);
    let differences = errors(&in_world(&found.gaussians, found.origin), &expected);
    print("a.sog", &differences);
    // Codebooks of 256 entries have no step; wrong rows would differ by everything.
    let [position, scale, opacity, color, _, degrees] = differences;
    assert!(
        position < 1e-3 && scale < 0.2 && opacity < 0.004,
        "{differences:?}"
    );
    assert!(color < 0.1 && degrees < 2.0, "{differences:?}");
    // splat-transform reads the same values.
    let theirs = dir.path().join("theirs.ply");
    assert!(convert(&path, &theirs, &[]));
    let differences = errors(&read(&theirs), &in_world(&found.gaussians, found.origin));
    let most = differences[..5].iter().copied().fold(0.0, f32::max);
    assert!(most < 2e-5 && differences[5] < 0.05, "{differences:?}");
}

#[test]
fn a_glb_file_has_every_value_exactly() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().expect("folder");
    let (scene, path) = exported(dir.path(), "a.glb");
    let file = parsed(&std::fs::read(&path).expect("a file"));
    assert_eq!(Some(file.labels()), scene.labels);
    let floats = |name: &str| file.floats(&format!("KHR_gaussian_splatting:{name}"));
    // Turned by 180 degrees about the z axis: x and y change their signs, and so do SH functions of odd order m.
    let turned = |[x, y, z]: [f32; 3]| [-x, -y, z];
    let quaternion = |&[x, y, z, w]: &[f32; 4]| [z, y, -x, -w];
    let parts: Vec<(usize, Vec<f32>)> = (0..4_usize)
        .flat_map(|l| (0..=2 * l).map(move |k| (l, k)))
        .map(|(l, k)| ((l + k) % 2, floats(&format!("SH_DEGREE_{l}_COEF_{k}"))))
        .collect();
    let n = scene.gaussians.len();
    let row = |row: usize| {
        parts.iter().flat_map(move |(odd, values)| {
            let sign = if *odd == 1 { -1.0 } else { 1.0 };
            [0, 1, 2].map(|channel| sign * values[3 * row + channel])
        })
    };
    let logs = |scales: &[f32; 3]| scales.map(f32::ln);
    let logit = |&p: &f32| (f64::from(p) / (1.0 - f64::from(p))).ln() as f32;
    let found = Gaussians {
        means: file
            .floats("POSITION")
            .as_chunks()
            .0
            .iter()
            .copied()
            .map(turned)
            .collect(),
        log_scales: floats("SCALE").as_chunks().0.iter().map(logs).collect(),
        rotations: floats("ROTATION")
            .as_chunks()
            .0
            .iter()
            .map(quaternion)
            .collect(),
        opacity_logits: floats("OPACITY").iter().map(logit).collect(),
        sh: (0..n).flat_map(row).collect(),
        sh_degree: 3,
    };
    let differences = errors(&found, &in_world(&scene.gaussians, scene.origin));
    print("a.glb", &differences);
    let most = differences[..5].iter().copied().fold(0.0, f32::max);
    assert!(most < 2e-6 && differences[5] < 0.05, "{differences:?}");
}
