//! Cameras without photos, from files of several tools.

mod graphdeco;
mod nerfstudio;

use super::camera_checks::side;
use super::layout;
use super::transforms::{self, not_finite::quoted};
use crate::data::{LoadOptions, NamedCamera, Split};
use crate::error::{Result, bail, ensure, invalid};
use crate::files;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The file of cameras in a run folder, and in the model folders of graphdeco's 3DGS.
const IN_FOLDER: &str = "cameras.json";

/// The cameras at `path`, in file order, in the units of the file; subtract a scene's origin before rendering. Photos are
/// read only where their size is not known otherwise. `split` keeps only those frames.
///
/// A folder may be a scene in any layout, as for [`crate::data::load_cameras`], or have a `cameras.json`, as run folders
/// do. The kind of a file follows from its content:
/// - `transforms.json` (instant-ngp, nerfstudio, this crate), as [`transforms::load_cameras`];
/// - `cameras.json` of graphdeco's 3DGS, a list of `width height position rotation fx fy` (camera-to-world, OpenCV axes) under
///   `img_name`: the principal point is the middle;
/// - a camera path of nerfstudio, `render_width render_height camera_path`, the last a list of `camera_to_world` (16 numbers by
///   rows, OpenGL axes) and `fov` (vertical, degrees): pixels are square, frames are called `path_0000` and so on.
///
/// The last two have no splits: all of their frames are for training.
///
/// # Errors
/// [`crate::Error::Input`] naming file and field, [`crate::Error::Io`] or [`crate::Error::Limit`]: malformed or unknown files,
/// numbers that make no camera, names given twice, no frame of `split`.
pub fn read_cameras(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    read_cameras_moved(path, None, split)
}

/// As [`read_cameras`], where nerfstudio's `dataparser_transforms.json`, if it is given, moves the cameras of a scene folder. Those of
/// other files stay.
///
/// # Errors
/// As [`read_cameras`]; [`crate::Error::Missing`] or [`crate::Error::Input`] naming nerfstudio's file.
pub fn read_cameras_moved(
    path: &Path,
    dataparser_transforms: Option<PathBuf>,
    split: Option<Split>,
) -> Result<Vec<NamedCamera>> {
    if !path.is_dir() {
        return read_file(path, split);
    }
    let options = LoadOptions {
        dataparser_transforms,
        ..LoadOptions::default()
    };
    let inside = path.join(IN_FOLDER);
    // Where the folder has two layouts, one has to be chosen.
    if inside.is_file() && layout::find(path, &options)?.is_none() {
        return read_file(&inside, split);
    }
    crate::data::load_cameras(path, &options, split)
}

fn read_file(path: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let unusable = |field: &str, found: &str| {
        invalid!(path, "{field}"; found "{found}";
            expected "cameras: a transforms.json, cameras.json of 3DGS, or camera path of nerfstudio";
            help "give a file of cameras, such as the cameras.json of a run")
    };
    let bytes = crate::files::read(path)?;
    if let Some(kind) = files::kind(&bytes).filter(|kind| *kind != "JSON") {
        return Err(unusable("first bytes", kind));
    }
    let text = std::str::from_utf8(&bytes).map_err(|_| unusable("first bytes", "no text"))?;
    // Python writes NaN into JSON.
    let (text, tokens) = quoted(files::without_mark(text));
    let value: Value = serde_json::from_str(&text)
        .map_err(|e| files::json_error(path, &e, "JSON with cameras"))?;
    let cameras = if value.is_array() {
        graphdeco::cameras(path, value)
    } else if value.get("frames").is_some() {
        // It has rules of its own about numbers that are not finite.
        drop(value);
        return transforms::load_cameras(path, split);
    } else if value.get("camera_path").is_some() {
        nerfstudio::cameras(path, value)
    } else {
        return Err(unusable("frames", "nothing"));
    };
    if let Some(token) = tokens.first() {
        bail!(path, "line {}", token.line; found "{}", token.text; expected "finite numbers";
            help "export the cameras again");
    }
    let cameras = cameras?;
    ensure!(split != Some(Split::Test), path, "split"; found "cameras without splits, all for training";
        expected "held-out cameras"; help "ask for all of them");
    Ok(cameras)
}

/// Width and height in pixels, which the fields of `place` gave: in all no more than an image may have. Without a place they are
/// fields of the file.
fn size(path: &Path, place: &str, sides: [(&str, f64); 2]) -> Result<[usize; 2]> {
    let [width, height] = sides.map(|(name, length)| {
        let field = format!("{place}.{name}");
        side(path, field.trim_start_matches('.'), length)
    });
    let size = [width?, height?];
    files::check_pixels(&path.join(place), size[0], size[1])?;
    Ok(size)
}

/// What serde makes of `value`, which is called `name` in messages; `expected` describes it there.
fn parsed<T: DeserializeOwned>(path: &Path, name: &str, value: Value, expected: &str) -> Result<T> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let field = match error.path().iter().next() {
            Some(_) => error.path().to_string(),
            None => "fields".to_owned(),
        };
        invalid!(path, "{name}{field}"; found "{}", error.inner(); expected "{expected}";
            help "correct the field, or export the cameras again")
    })
}

/// Refuses a list of cameras that is empty, or longer than a scene may be.
fn check_count(path: &Path, field: &str, count: usize) -> Result<()> {
    ensure!(count > 0, path, "{field}"; found "no cameras"; expected "at least one"; help "export them again");
    files::check_views(path, count)
}
