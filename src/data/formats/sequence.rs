//! What recorded sequences (Replica, ScanNet) have in common: files with a number in their names, poses as text.

use crate::error::{Error, Result};
use crate::splat::camera::{Camera, Intrinsics};
use glam::{DMat3, DMat4};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Files of `folder` named `prefix`, a number, and one of `extensions`, by number: `rgb_10.png` follows `rgb_9.png`.
///
/// # Errors
/// The folder cannot be read; two files have the same number.
pub(crate) fn numbered(
    folder: &Path,
    prefix: &str,
    extensions: &[&str],
) -> Result<BTreeMap<usize, PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let mut files: BTreeMap<usize, PathBuf> = BTreeMap::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        let extension = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or_default()
            .to_lowercase();
        let digits = path
            .file_stem()
            .and_then(|s| s.to_str())
            .and_then(|s| s.strip_prefix(prefix));
        let number = digits
            .filter(|d| d.bytes().all(|b| b.is_ascii_digit()))
            .and_then(|d| d.parse().ok());
        let Some(number) = number.filter(|_| extensions.contains(&&*extension)) else {
            continue;
        };
        if let Some(other) = files.insert(number, path.clone()) {
            let found = format!("{} and {}", other.display(), path.display());
            let help = "take one of the two away";
            return Err(Error::input(
                folder,
                format!("number {number}"),
                found,
                "one file a number",
                help,
            ));
        }
    }
    Ok(files)
}

/// A camera-to-world matrix in OpenCV axes, row by row. Lost poses hold infinities.
pub(crate) type Pose = [f64; 16];

/// Reads 16 numbers separated by blanks; `field` says where in `path` they stand.
///
/// # Errors
/// There are more or fewer, or they are no numbers.
pub(crate) fn pose(text: &str, path: &Path, field: &str) -> Result<Pose> {
    let error = |found: String| {
        let expected = "16 numbers: a 4x4 camera-to-world matrix, row by row";
        Error::input(
            path,
            field,
            found,
            expected,
            "copy the file again, or drop the frame",
        )
    };
    let mut pose = [0.0; 16];
    let mut words = text.split_ascii_whitespace();
    for (i, value) in pose.iter_mut().enumerate() {
        let word = words.next().ok_or_else(|| error(format!("{i} numbers")))?;
        *value = word
            .parse()
            .map_err(|_| error(format!("{:?}", word.chars().take(40).collect::<String>())))?;
    }
    match words.next() {
        Some(_) => Err(error("more than 16 numbers".into())),
        None => Ok(pose),
    }
}

/// The camera of a pose.
///
/// # Errors
/// The pose is not finite or no rotation and translation.
pub(crate) fn camera(
    pose: &Pose,
    intrinsics: Intrinsics,
    path: &Path,
    field: &str,
) -> Result<Camera> {
    let error = |found: String, expected: &str| {
        Error::input(
            path,
            field,
            found,
            expected,
            "drop the frame, or export its pose again",
        )
    };
    if let Some(i) = pose.iter().position(|v| !(*v as f32).is_finite()) {
        let found = format!("{} in row {}, column {}", pose[i], i / 4, i % 4);
        return Err(error(found, "finite numbers (f32)"));
    }
    if pose[12..]
        .iter()
        .zip([0.0, 0.0, 0.0, 1.0])
        .any(|(v, want)| (v - want).abs() > 1e-6)
    {
        return Err(error(format!("last row {:?}", &pose[12..]), "[0, 0, 0, 1]"));
    }
    // The matrix is stored by rows.
    let matrix = DMat4::from_cols_array(pose).transpose();
    Camera::from_opencv(&matrix, intrinsics).ok_or_else(|| {
        let m = DMat3::from_mat4(matrix);
        let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|a| a.length());
        let found = format!(
            "column lengths {lengths:.4?}, determinant {:.4}",
            m.determinant()
        );
        error(
            found,
            "a rotation (orthonormal columns, determinant +1) and a translation",
        )
    })
}
