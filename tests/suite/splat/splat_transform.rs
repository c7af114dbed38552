//! The program splat-transform reads what this one writes, and the other way round.

use crate::support::program::text;
use crate::support::rounding::{errors, gaussians};
use coseg::splat::Gaussians;
use coseg::splat::formats::{self, Format};
use coseg::splat::ply;
use glam::DVec3;
use std::path::Path;
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

/// COSEG_SCENE names a scene whose errors are printed instead of those of made-up Gaussians.
#[test]
fn splat_transform_reads_and_writes_the_same_values() {
    let version = Command::new("splat-transform").arg("--version").output();
    let said = |output: std::process::Output| text(&[output.stdout, output.stderr].concat());
    let version = version.map(said).unwrap_or_default();
    // Version 2 turns .spz files by 180 degrees about the x axis.
    if version.is_empty() || version.starts_with("splat-transform v2.") {
        eprintln!("SKIPPED: no splat-transform 3 or later on the PATH");
        return;
    }
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let scene =
        std::env::var_os("COSEG_SCENE").map(|path| ply::read(path.as_ref()).expect("a scene"));
    let (scene, origin) = scene.map_or_else(
        || (gaussians(3_000, 3), DVec3::ZERO),
        |s| (s.gaussians, s.origin),
    );
    ply::write(&at("scene.ply"), &scene, origin, None).expect("write");
    let mut ordered = scene.select(&scene.spatial_order());
    for mean in &mut ordered.means {
        *mean = (DVec3::from(mean.map(f64::from)) + origin)
            .as_vec3()
            .to_array();
    }
    for (name, format, options) in [
        ("a.spz", Format::Spz, &["--spz-version", "3"][..]),
        ("a.spz", Format::Spz, &["--spz-version", "4"]),
        ("a.compressed.ply", Format::CompressedPly, &[]),
    ] {
        formats::write(&at(name), format, &scene, origin, None).expect("write");
        assert!(convert(&at(name), &at("ours.ply"), &[]));
        let theirs = read(&at("ours.ply"));
        let differences = errors(&theirs, &read(&at(name)));
        println!("{name}, {} Gaussians", theirs.len());
        let what = [
            "position",
            "log-scale",
            "opacity",
            "colour",
            "SH",
            "rotation in degrees",
        ];
        for (what, error) in what.iter().zip(errors(&theirs, &ordered)) {
            println!("  {what}: at most {error:.2e}");
        }
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
