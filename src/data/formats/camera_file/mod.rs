//! Cameras without photos, from files of several tools.

mod entry;
mod graphdeco;
mod nerfstudio;

use super::layout;
use super::transforms::{self, not_finite::blanked};
use crate::data::photos::file_kind;
use crate::data::{Limits, LoadOptions, NamedCamera, Split};
use crate::error::{Error, Result};
use crate::splat::camera::{Camera, Intrinsics};
use entry::Entry;
use glam::{DMat3, DMat4};
use serde_json::Value;
use std::path::Path;

/// The file of cameras in a run folder, and in the model folders of graphdeco's 3DGS.
const IN_FOLDER: &str = "cameras.json";
const EXPECTED: &str =
    "cameras: a transforms.json, cameras.json of 3DGS, or camera path of nerfstudio";
const MEND: &str = "give a file of cameras, such as the cameras.json of a run";

/// The cameras at `path`, in their order, without looking at photos more than needed. In world units, where the writer of the
/// file had them; subtract a scene's origin before rendering it. `split` keeps only those frames.
///
/// Of a folder they are those of a scene in any layout, as [`crate::data::load_cameras`], or else of the `cameras.json` in it, as run
/// folders have one. Of a file the content tells which it is:
/// - `transforms.json` (instant-ngp, nerfstudio, this crate), as [`transforms::load_cameras`];
/// - `cameras.json` of graphdeco's 3DGS, a list of `width height position rotation fx fy` (camera-to-world, OpenCV axes) under
///   `img_name`: the principal point is the middle;
/// - a camera path of nerfstudio, `render_width render_height camera_path`, the last a list of `camera_to_world` (16 numbers by
///   rows, OpenGL axes) and `fov` (vertical, degrees): pixels are square, frames are called `path_0000` and so on.
///
/// The last two know no splits: all of their frames are for training.
///
/// # Errors
/// [`Error::Input`] naming file and field, [`Error::Io`] or [`Error::Limit`]: malformed or unknown files, numbers that make no
/// camera, names given twice, no frame of `split`.
pub fn read_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    if path.is_dir() {
        let options = LoadOptions::default();
        let inside = path.join(IN_FOLDER);
        return match layout::locate(path, &options) {
            // Nothing else is there to be read; of two layouts one has to be chosen.
            Err(Error::Input { found, .. })
                if inside.is_file() && found.starts_with("no such file") =>
            {
                read_cameras(&inside, split)
            }
            _ => crate::data::load_cameras(path, &options, split),
        };
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    if let Some(kind) = file_kind::by_first_bytes(&bytes).filter(|kind| *kind != "JSON") {
        return Err(Error::input(path, "first bytes", kind, EXPECTED, MEND));
    }
    let Ok(text) = std::str::from_utf8(&bytes) else {
        return Err(Error::input(path, "first bytes", "no text", EXPECTED, MEND));
    };
    // Python writes NaN into JSON.
    let (blank, tokens) = blanked(text);
    let value: Value = serde_json::from_str(&blank).map_err(|e| {
        let help = "correct the file there or export it again";
        Error::input(
            path,
            format!("line {}", e.line()),
            e.to_string(),
            "JSON with cameras",
            help,
        )
    })?;
    let read = match &value {
        Value::Array(list) => graphdeco::cameras(path, list),
        Value::Object(object) if object.contains_key("frames") => {
            // It has rules of its own about what is no number.
            drop(value);
            return transforms::load_cameras(path, split);
        }
        Value::Object(object) if object.contains_key("camera_path") => {
            nerfstudio::cameras(path, &value)
        }
        _ => return Err(Error::input(path, "frames", "nothing", EXPECTED, MEND)),
    };
    if let Some(token) = tokens.first() {
        let help = "export the cameras again";
        return Err(Error::input(
            path,
            format!("line {}", token.line),
            token.text,
            "finite numbers",
            help,
        ));
    }
    let cameras = read?;
    if split == Some(Split::Test) {
        let found = "cameras without splits, all for training";
        return Err(Error::input(
            path,
            "split",
            found,
            "held-out cameras",
            "ask for all of them",
        ));
    }
    Ok(cameras)
}

/// No list is empty, or longer than a scene may be.
fn check_count(path: &Path, field: &str, list: &[Value]) -> Result<()> {
    if list.is_empty() {
        return Err(Error::input(
            path,
            field,
            "no cameras",
            "at least one",
            "export them again",
        ));
    }
    let (found, limit) = (list.len() as u64, Limits::default().views as u64);
    Limits::check(
        format!("{}: {field}", path.display()),
        found,
        limit,
        "drop some of them",
    )
}

/// A camera with its principal point in the middle. `field` of `entry` is where its pose `c2w`, OpenCV axes, came from.
fn centred(
    entry: &Entry<'_>,
    field: &str,
    [fx, fy]: [f64; 2],
    size: [usize; 2],
    c2w: DMat4,
) -> Result<Camera> {
    let [width, height] = size;
    let intrinsics = Intrinsics {
        fx,
        fy,
        cx: 0.5 * width as f64,
        cy: 0.5 * height as f64,
        width,
        height,
    };
    Camera::from_opencv(&c2w, intrinsics).ok_or_else(|| {
        let m = DMat3::from_mat4(c2w);
        let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|a| a.length());
        let found = format!(
            "column lengths {lengths:.4?}, determinant {:.4}",
            m.determinant()
        );
        let expected = "a rotation (orthonormal columns, determinant +1)";
        entry.error(
            field,
            found,
            expected,
            "remove scale, shear and mirroring from the pose",
        )
    })
}
