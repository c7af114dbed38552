//! A camera path as nerfstudio's viewer exports it: camera-to-world by rows with OpenGL axes, vertical field of view in
//! degrees.
//!
//! Its coordinates are nerfstudio's normalised ones, as are those of the PLY files that `ns-export` writes of the same run.

use super::entry::Entry;
use crate::data::{NamedCamera, Split};
use crate::error::Result;
use glam::{DMat4, DVec4};
use serde_json::Value;
use std::path::Path;

pub(super) fn cameras(path: &Path, value: &Value) -> Result<Vec<NamedCamera>> {
    let whole = Entry::new(path, String::new(), value);
    let kind = whole
        .get("camera_type")
        .and_then(Value::as_str)
        .unwrap_or("perspective");
    if !kind.eq_ignore_ascii_case("perspective") {
        let help = "export the path with a perspective camera";
        return Err(whole.error("camera_type", &format!("{kind:?}"), "\"perspective\"", help));
    }
    let size = whole.size(["render_width", "render_height"])?;
    let list = whole.cameras("camera_path")?;
    list.iter()
        .enumerate()
        .map(|(i, value)| camera(path, i, value, size))
        .collect()
}

fn camera(path: &Path, i: usize, value: &Value, size: [usize; 2]) -> Result<NamedCamera> {
    let entry = Entry::new(path, format!("camera_path[{i}]."), value);
    let fov = entry.number("fov")?;
    if !(fov > 0.0 && fov < 180.0) {
        let expected = "vertical degrees above 0, below 180";
        let help = "correct the field of view";
        return Err(entry.error("fov", &format!("{fov:?}"), expected, help));
    }
    let focal = 0.5 * size[1] as f64 / (0.5 * fov.to_radians()).tan();
    let focal = entry.check_focal("fov", focal)?;
    let field = "camera_to_world";
    // By rows.
    let c2w = DMat4::from_cols_array(&entry.numbers(field)?).transpose();
    let last = c2w.row(3);
    if !last.abs_diff_eq(DVec4::W, 1e-6) {
        let help = "write the matrix by rows, its translation at the end of each";
        return Err(entry.error(field, &format!("a last row of {last}"), "0, 0, 0, 1", help));
    }
    // From OpenGL's axes: y and z the other way.
    let c2w = DMat4::from_cols(c2w.x_axis, -c2w.y_axis, -c2w.z_axis, c2w.w_axis);
    let camera = entry.centred(field, [focal; 2], size, &c2w)?;
    let name = format!("path_{i:04}");
    Ok(NamedCamera {
        name,
        split: Split::Train,
        camera,
    })
}
