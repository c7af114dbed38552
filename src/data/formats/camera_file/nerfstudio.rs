//! A camera path as nerfstudio's viewer exports it: camera-to-world by rows with OpenGL axes, vertical field of view in
//! degrees.
//!
//! Its coordinates are nerfstudio's normalised ones, as are those of the PLY files that `ns-export` writes of the same run.

use super::{check_count, parsed, size};
use crate::data::formats::camera_checks::{check_focal, posed};
use crate::data::{NamedCamera, Split};
use crate::error::{Result, ensure};
use crate::splat::camera::Camera;
use glam::DMat4;
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// The file. Other fields are not read.
#[derive(Deserialize)]
struct PathFile {
    camera_type: Option<String>,
    /// Pixels; some versions write `160.0`.
    render_width: f64,
    render_height: f64,
    camera_path: Vec<Entry>,
}

/// A camera of the path.
#[derive(Deserialize)]
#[serde(expecting = "a camera with camera_to_world and fov")]
struct Entry {
    /// By rows.
    camera_to_world: [f64; 16],
    /// Vertical, degrees.
    fov: f64,
}

pub(super) fn cameras(path: &Path, value: Value) -> Result<Vec<NamedCamera>> {
    let file: PathFile = parsed(path, "", value, "a camera path as nerfstudio writes it")?;
    let kind = file.camera_type.as_deref().unwrap_or("perspective");
    ensure!(kind.eq_ignore_ascii_case("perspective"), path, "camera_type"; found "{kind:?}"; expected "\"perspective\"";
        help "export the path with a perspective camera");
    let sides = [
        ("render_width", file.render_width),
        ("render_height", file.render_height),
    ];
    let size = size(path, "", sides)?;
    check_count(path, "camera_path", file.camera_path.len())?;
    let cameras = file.camera_path.iter().enumerate().map(|(i, entry)| {
        Ok(NamedCamera {
            name: format!("path_{i:04}"),
            split: Split::Train,
            camera: entry.camera(path, &format!("camera_path[{i}]"), size)?,
        })
    });
    cameras.collect()
}

impl Entry {
    fn camera(&self, path: &Path, place: &str, size: [usize; 2]) -> Result<Camera> {
        let fov = self.fov;
        let help = "correct the field of view";
        ensure!(fov > 0.0 && fov < 180.0, path, "{place}.fov"; found "{fov:?}"; expected "vertical degrees above 0, below 180";
            help "{help}");
        let focal = 0.5 * size[1] as f64 / (0.5 * fov.to_radians()).tan();
        check_focal(path, &format!("{place}.fov"), focal, help)?;
        let c2w = DMat4::from_cols_array(&self.camera_to_world).transpose();
        posed(path, &format!("{place}.camera_to_world"), &c2w, |pose| {
            Camera::centred([focal; 2], size).with_opengl_pose(pose)
        })
    }
}
