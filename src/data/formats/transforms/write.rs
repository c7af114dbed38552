//! Cameras as a `transforms.json` that [`super::load_cameras`] and other tools read.

use crate::data::NamedCamera;
use crate::error::Result;
use crate::files::atomic;
use serde_json::{Value, json};
use std::path::Path;

/// Writes `cameras` (positions in world units) as pinholes without distortion, each frame with its own size and intrinsics.
/// `file_path` is the name of the view with `.png`; folders in a name become part of the file name.
///
/// # Errors
/// [`crate::Error::Io`].
pub fn write_cameras(path: &Path, cameras: &[NamedCamera]) -> Result<()> {
    atomic::write_bytes(path, cameras_text(cameras).as_bytes())
}

/// The content of the file that [`write_cameras`] writes.
pub(crate) fn cameras_text(cameras: &[NamedCamera]) -> String {
    let frame = |named: &NamedCamera| {
        let camera = &named.camera;
        json!({
            "file_path": format!("{}.png", named.name.replace(['/', '\\'], "_")),
            "split": named.split,
            "w": camera.width,
            "h": camera.height,
            "fl_x": camera.fx,
            "fl_y": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            // Rows of the OpenGL camera-to-world matrix.
            "transform_matrix": camera.to_opengl().transpose().to_cols_array_2d(),
        })
    };
    let frames: Vec<Value> = cameras.iter().map(frame).collect();
    let file = json!({ "camera_model": "PINHOLE", "frames": frames });
    // Its alternate form is indented.
    format!("{file:#}\n")
}
