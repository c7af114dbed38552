//! Gaussians that nerfstudio trained in a world of its own, and the file that says how it moved the poses.

use crate::support::capture::rows;
use crate::support::plate_runs::config;
use crate::support::transforms_json::edit;
use crate::support::{assert_names, device, plates};
use coseg::data::{LoadOptions, Scene, load};
use coseg::pipeline::score_images;
use coseg::splat::{Gaussians, Motion};
use glam::{DMat4, DQuat, DVec3, EulerRot, Vec3};
use serde_json::json;
use std::path::Path;

const FILE: &str = "dataparser_transforms.json";
const APPLIED_SCALE: f64 = 2.0;
/// From the poses of the folder to those that nerfstudio trains on.
const SCALE: f64 = 0.37;

fn rigid(angles: [f64; 3], translation: [f64; 3]) -> DMat4 {
    let [a, b, c] = angles;
    let turn = DQuat::from_euler(EulerRot::XYZ, a, b, c);
    DMat4::from_rotation_translation(turn, DVec3::from(translation))
}

/// A folder of the plates with nerfstudio's file, and the Gaussians as nerfstudio would export them.
fn exported(dir: &Path) -> Gaussians {
    plates::scene(dir);
    // From the COLMAP model to the folder, and to nerfstudio's world.
    let applied = rigid([1.2, 0.3, -0.4], [0.3, -0.2, 0.7]);
    let transform = rigid([-0.6, 2.1, 0.9], [-1.5, 0.4, 0.2]);
    edit(dir, |file| {
        file["applied_transform"] = json!(rows(applied)[..3]);
        file["applied_scale"] = json!(APPLIED_SCALE);
        file["ply_file_path"] = json!("plates.ply");
    });
    let text = json!({ "transform": rows(transform)[..3], "scale": SCALE * APPLIED_SCALE });
    std::fs::write(dir.join(FILE), text.to_string()).unwrap();
    let moved = transform * applied.inverse();
    let (mut gaussians, _) = plates::plates();
    let motion = Motion {
        rotation: DQuat::from_mat4(&moved),
        pivot: DVec3::ZERO,
        translation: moved.w_axis.truncate(),
    };
    let all: Vec<u32> = (0..gaussians.len() as u32).collect();
    motion.apply(&mut gaussians, &all);
    let means = gaussians.means.as_flattened_mut().iter_mut();
    means.for_each(|v| *v *= SCALE as f32);
    let scales = gaussians.log_scales.as_flattened_mut().iter_mut();
    scales.for_each(|v| *v += SCALE.ln() as f32);
    gaussians
}

fn psnr(dir: &Path, scene: &Scene, gaussians: &Gaussians) -> f64 {
    let mut gaussians = gaussians.clone();
    for mean in &mut gaussians.means {
        *mean = (Vec3::from(*mean) - scene.origin.as_vec3()).to_array();
    }
    let scores = score_images(&gaussians, scene, &config(dir), &device()).expect("scores");
    scores.psnr.expect("held-out views")
}

fn in_nerfstudios_world(dir: &Path) -> LoadOptions {
    LoadOptions {
        dataparser_transforms: Some(dir.join(FILE)),
        ..LoadOptions::default()
    }
}

#[test]
fn poses_and_points_go_where_nerfstudio_had_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let gaussians = exported(folder.path());
    let apart = load(folder.path(), &LoadOptions::default()).expect("a scene");
    let scene = load(folder.path(), &in_nerfstudios_world(folder.path())).expect("a scene");
    let psnrs = [&apart, &scene].map(|scene| psnr(folder.path(), scene, &gaussians));
    assert!(psnrs[0] < 25.0 && psnrs[1] > 40.0, "{psnrs:?}");
    assert_eq!(scene.points.len(), gaussians.len());
    for (point, mean) in scene.points.positions.iter().zip(&gaussians.means) {
        let point = DVec3::from(point.map(f64::from)) + scene.origin;
        let distance = point.distance(DVec3::from(mean.map(f64::from)));
        assert!(distance < 1e-5, "{point} {mean:?}");
    }
}

#[test]
fn a_file_that_cannot_be_meant_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    exported(folder.path());
    let file = folder.path().join(FILE);
    let mirror = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]];
    let identity = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
    let cases: [(serde_json::Value, &str); 5] = [
        (json!({ "transform": mirror, "scale": 1.0 }), "transform"),
        (
            json!({ "transform": identity[..2], "scale": 1.0 }),
            "transform",
        ),
        (
            json!({ "transform": [[1, 0, 0]], "scale": 1.0 }),
            "transform",
        ),
        (json!({ "transform": identity, "scale": 0.0 }), "scale"),
        (json!({ "scale": 1.0 }), "transform"),
    ];
    for (value, field) in cases {
        std::fs::write(&file, value.to_string()).unwrap();
        let error = load(folder.path(), &in_nerfstudios_world(folder.path())).expect_err("refused");
        assert_names(&error, &[FILE, field, "nerfstudio"]);
    }
    std::fs::remove_file(&file).unwrap();
    let error = load(folder.path(), &in_nerfstudios_world(folder.path())).expect_err("refused");
    assert_names(&error, &[FILE, "config.yml"]);
}
