//! Photos with their cameras and a cloud, written in any convention of poses.

use crate::support::transforms_json::edit;
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::data::{Checked, LoadOptions, check};
use coseg::splat::camera::Camera;
use glam::{DMat4, DVec3};
use serde_json::json;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// World-to-camera or not, OpenCV axes or OpenGL.
pub type Convention = (bool, bool);
pub const CONVENTIONS: [Convention; 4] =
    [(false, false), (true, false), (false, true), (true, true)];

/// What the program calls a convention.
pub fn name((to_camera, opencv): Convention) -> &'static str {
    match (to_camera, opencv) {
        (false, false) => "if they are camera-to-world in OpenGL axes",
        (true, false) => "if they are world-to-camera in OpenGL axes",
        (false, true) => "if they are camera-to-world in OpenCV axes",
        (true, true) => "if they are world-to-camera in OpenCV axes",
    }
}

/// The matrix of `camera` as a convention has it.
pub fn matrix(camera: &Camera, (to_camera, opencv): Convention) -> DMat4 {
    let mut matrix = camera.to_opengl();
    if opencv {
        matrix = DMat4::from_cols(matrix.x_axis, -matrix.y_axis, -matrix.z_axis, matrix.w_axis);
    }
    if to_camera { matrix.inverse() } else { matrix }
}

/// The rows of a matrix, as JSON has them.
pub fn rows(matrix: DMat4) -> Vec<[f64; 4]> {
    (0..4).map(|r| matrix.row(r).to_array()).collect()
}

/// Photos with their cameras, and the file of an initial cloud.
pub struct Capture {
    pub shots: Vec<(PathBuf, Camera)>,
    pub cloud: PathBuf,
}

impl Capture {
    /// The built-in room, small, with its photos and points in `dir`.
    pub fn room(dir: &Path, train_views: usize) -> Self {
        let options = BuiltinOptions {
            width: 96,
            height: 72,
            train_views,
            test_views: 2,
            ..Default::default()
        };
        let scene = scene_with(&options).unwrap();
        let mut shots = Vec::new();
        for view in &scene.views {
            let path = dir.join(format!("{}.png", view.name));
            view.image.pixels().unwrap().save(&path).unwrap();
            shots.push((
                path,
                Camera {
                    center: view.camera.center + scene.origin,
                    ..view.camera.clone()
                },
            ));
        }
        let mut text = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            scene.points.len()
        );
        for (p, c) in scene.points.positions.iter().zip(&scene.points.colors) {
            let p = DVec3::from(p.map(f64::from)) + scene.origin;
            let [r, g, b] = c.map(|c| (c * 255.0).round() as u8);
            writeln!(text, "{} {} {} {r} {g} {b}", p.x, p.y, p.z).unwrap();
        }
        let cloud = dir.join("room.ply");
        fs::write(&cloud, text).unwrap();
        Self { shots, cloud }
    }

    /// Writes `transforms.json` with all cameras moved by `offset`, and without the cloud. Every seventh photo is held out.
    pub fn moved(&self, dir: &Path, offset: DVec3) {
        let frame = |(i, (path, c)): (usize, &(PathBuf, Camera))| {
            json!({
                "file_path": path, "transform_matrix": rows(c.moved(offset).to_opengl()), "w": c.width, "h": c.height,
                "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "split": if i % 7 == 6 { "test" } else { "train" },
            })
        };
        let frames: Vec<_> = self.shots.iter().enumerate().map(frame).collect();
        fs::write(
            dir.join("transforms.json"),
            json!({ "frames": frames }).to_string(),
        )
        .unwrap();
    }

    /// Writes `transforms.json` in a convention that may not be its own. Every `stride`-th photo.
    pub fn transforms(&self, dir: &Path, convention: Convention, stride: usize) {
        let frame = |(path, c): &(PathBuf, Camera)| {
            json!({
                "file_path": path, "transform_matrix": rows(matrix(c, convention)), "w": c.width, "h": c.height,
                "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy,
            })
        };
        let frames: Vec<_> = self.shots.iter().step_by(stride).map(frame).collect();
        let file = json!({ "ply_file_path": self.cloud, "frames": frames });
        fs::write(dir.join("transforms.json"), file.to_string()).unwrap();
    }
}

/// The one problem of a folder, which must hold all of `parts`.
#[track_caller]
pub fn one_problem(checked: &Checked, parts: &[&str]) {
    assert_eq!(checked.problems.len(), 1, "{checked:?}");
    crate::support::assert_names(&checked.problems[0], parts);
}

/// The conventions that the notices of a folder say its poses may be of.
pub fn suspected(dir: &Path) -> Vec<String> {
    let checked = check(dir, &LoadOptions::default());
    assert!(checked.problems.is_empty(), "{checked:?}");
    let told = checked
        .notices
        .iter()
        .filter(|n| n.contains("the poses may be "))
        .cloned();
    told.inspect(|n| eprintln!("{n}")).collect()
}

/// Takes the cloud out of `transforms.json`.
pub fn without_cloud(dir: &Path) {
    edit(dir, |v| {
        _ = v.as_object_mut().unwrap().remove("ply_file_path")
    });
}
