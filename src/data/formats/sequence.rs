//! Shared by recorded sequences (Replica, ScanNet): numbered files, poses as text, depth images.

use super::camera_checks::posed;
use super::depth::Depth;
use super::frame::Frame;
use super::listing::Cloud;
use super::side_folders::SideFolders;
use crate::data::Split;
use crate::error::{Result, invalid};
use crate::files::{Numbered, numbered};
use crate::splat::camera::Camera;
use glam::DMat4;
use std::path::{Path, PathBuf};

/// Value of a metre in depth images.
pub(crate) const MILLIMETRES: f64 = 1000.0;

/// The first of `folders` of label maps that exists. Its files are named `prefix` and a number. `None` without such a folder.
pub(crate) fn numbered_maps(dir: &Path, folders: &[&str], prefix: &str) -> Result<Numbered> {
    let mut folders = folders.iter().map(|name| dir.join(name));
    match folders.find(|folder| folder.is_dir()) {
        Some(folder) => numbered(&folder, prefix, &["png"]),
        None => Ok(Numbered::new()),
    }
}

/// The frame of a photo, with the instances of its number.
pub(crate) fn frame(
    image: &Path,
    split: Split,
    camera: Camera,
    folders: &SideFolders,
    instances: Option<&PathBuf>,
) -> Frame {
    let photo = PathBuf::from(image.file_name().unwrap_or_default());
    let name = photo.with_extension("").to_string_lossy().into_owned();
    Frame {
        instances: instances.cloned(),
        ..folders.frame(Frame::new(name, split, image.to_owned(), camera), &photo)
    }
}

/// The initial cloud: `points.ply` in the scene folder, else the depth images of `frames`, which `file` names.
pub(crate) fn cloud(
    dir: &Path,
    frames: &[Frame],
    scale: f64,
    file: impl Fn(&str) -> String,
) -> Cloud {
    let path = dir.join("points.ply");
    if path.is_file() {
        return Cloud::Ply(path);
    }
    let files = frames
        .iter()
        .map(|frame| Some(dir.join(file(&frame.name))).filter(|file| file.is_file()));
    let files: Vec<_> = files.collect();
    if files.iter().all(Option::is_none) {
        return Cloud::None;
    }
    Cloud::Depth(Depth { files, scale })
}

/// A camera-to-world matrix in OpenCV axes, row by row. Lost poses are infinite.
pub(crate) type Pose = [f64; 16];

/// Reads 16 numbers separated by blanks; `field` names their place in `path`.
///
/// # Errors
/// There are not exactly 16 numbers.
pub(crate) fn pose(text: &str, path: &Path, field: &str) -> Result<Pose> {
    let error = |found: String| {
        invalid!(path, "{field}"; found "{found}";
            expected "16 numbers: a 4x4 camera-to-world matrix, row by row";
            help "copy the file again, or drop the frame")
    };
    let number = |word: &str| word.parse().map_err(|_| error(format!("{word:?}")));
    let words = text.split_ascii_whitespace().take(17);
    let numbers = words.map(number).collect::<Result<Vec<f64>>>()?;
    numbers
        .try_into()
        .map_err(|numbers: Vec<f64>| match numbers.len() {
            17 => error("more than 16 numbers".into()),
            count => error(format!("{count} numbers")),
        })
}

/// The camera of a pose.
///
/// # Errors
/// As [`posed`].
pub(crate) fn camera(pose: &Pose, intrinsics: &Camera, path: &Path, field: &str) -> Result<Camera> {
    // The matrix is stored by rows.
    let matrix = DMat4::from_cols_array(pose).transpose();
    posed(path, field, &matrix, |pose| {
        intrinsics.clone().with_opencv_pose(pose)
    })
}
