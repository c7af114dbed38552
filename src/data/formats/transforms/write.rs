//! Cameras as a `transforms.json` that [`super::load_cameras`] and other tools read.

use crate::data::{NamedCamera, Split};
use crate::error::Result;
use crate::files::atomic;
use serde::Serialize;
use std::path::Path;

#[derive(Serialize)]
struct File<'a> {
    camera_model: &'a str,
    frames: Vec<FrameOut>,
}

#[derive(Serialize)]
struct FrameOut {
    file_path: String,
    split: Split,
    w: usize,
    h: usize,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    /// Rows of the OpenGL camera-to-world matrix.
    transform_matrix: [[f64; 4]; 4],
}

/// Writes `cameras` (positions in world units) as pinholes without distortion, each frame with its own size and intrinsics.
/// `file_path` is the name of the view with `.png`; folders in a name become part of the file name.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn write_cameras(path: &Path, cameras: &[NamedCamera]) -> Result<()> {
    let frame = |named: &NamedCamera| {
        let camera = &named.camera;
        FrameOut {
            file_path: format!("{}.png", named.name.replace(['/', '\\'], "_")),
            split: named.split,
            w: camera.width,
            h: camera.height,
            fl_x: camera.fx,
            fl_y: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            transform_matrix: camera.to_opengl().transpose().to_cols_array_2d(),
        }
    };
    let file = File {
        camera_model: "PINHOLE",
        frames: cameras.iter().map(frame).collect(),
    };
    atomic::write_json(path, &file)
}
