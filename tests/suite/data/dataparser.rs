//! Gaussians that nerfstudio trained in a world of its own, and the file that says how it moved the poses.

use crate::support::capture::rows;
use crate::support::plate_runs::config;
use crate::support::program::{fails, succeeds, utf8};
use crate::support::transforms_json::edit;
use crate::support::{assert_names, device, plates, rendered_views};
use coseg::data::{LoadOptions, Scene, load, read_cameras};
use coseg::pipeline::score_images;
use coseg::splat::{Gaussians, Motion, ply};
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

#[test]
fn cameras_of_the_scene_folder_follow_the_run_of_a_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path();
    let gaussians = exported(dir);
    let [exported, run, out] = ["exported.ply", "run", "selected"].map(|name| dir.join(name));
    ply::write(&exported, &gaussians, DVec3::ZERO, None).unwrap();
    let train = ["train", "--data", utf8(dir), "--scene", utf8(&exported)];
    let world = format!("data.dataparser_transforms={}", dir.join(FILE).display());
    let sets = ["--set", &world, "--set", "segmentation.rows=vote"];
    succeeds(&[&train[..], &sets, &["--out", utf8(&run)]].concat());
    let given = ["--cameras", utf8(dir)];
    let [own, moved] = [("own", &[][..]), ("moved", &given[..])].map(|(name, cameras)| {
        let out = dir.join(name);
        let split = ["--split", "test"];
        rendered_views::render(&run, &out, &[cameras, &split].concat());
        image::open(out.join("v2.rgb.png")).unwrap().into_rgb8()
    });
    let bytes = || own.iter().zip(moved.iter());
    assert!(own.iter().any(|byte| *byte > 50));
    assert!(bytes().all(|(a, b)| a.abs_diff(*b) <= 1));
    let (x, y) = (plates::WIDTH / 2, plates::HEIGHT / 2 - 2);
    let pixel = format!("{x},{y}");
    let at = ["--frame", "images/v3.png", "--pixel", &pixel];
    let objects = ["objects", "--scene", utf8(&run)];
    let picked = [&[][..], &given].map(|given| succeeds(&[&objects[..], given, &at].concat()));
    assert!(picked[0].contains("2 green"), "{}", picked[0]);
    assert_eq!(picked[0], picked[1]);
    let select = ["select", "--scene", utf8(&run), "--name", "plate"];
    succeeds(&[&select[..], &given, &at, &["--out", utf8(&out)]].concat());
    let [of_run, used] = [&run, &out].map(|folder| read_cameras(folder, None).unwrap());
    for (a, b) in of_run.iter().zip(&used) {
        assert!(a.camera.center.distance(b.camera.center) < 1e-9);
    }
    // The file that moves them is named where it is gone.
    std::fs::remove_file(dir.join(FILE)).unwrap();
    let message = fails(&[&objects[..], &given, &at].concat(), 1);
    assert!(message.contains(FILE), "{message}");
}
