//! Limits and checks for the cameras of all formats.

use crate::error::{Error, invalid};
use glam::{DMat3, DMat4};
use std::ops::RangeInclusive;
use std::path::Path;

/// Range of plausible focal lengths, pixels.
pub(crate) const FOCAL: RangeInclusive<f64> = 1e-3..=1e9;
/// Largest plausible distance of a principal point from the image corner, pixels.
pub(crate) const MAX_PIXELS: f64 = 1e9;

/// Whether a number is finite in f32 as well.
pub(crate) fn fits_f32(value: f64) -> bool {
    (value as f32).is_finite()
}

/// Column lengths and determinant of a pose, which show why it is no rotation.
pub(crate) fn describe_rotation(pose: &DMat4) -> String {
    let m = DMat3::from_mat4(*pose);
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|axis| axis.length());
    format!(
        "column lengths {lengths:.4?}, determinant {:.4}",
        m.determinant()
    )
}

/// The error for a pose that is no rotation and translation.
pub(crate) fn not_a_rotation(path: &Path, field: &str, pose: &DMat4) -> Error {
    invalid!(path, "{field}"; found "{}", describe_rotation(pose);
        expected "a rotation (orthonormal columns, determinant +1) and a translation";
        help "remove scale, shear and mirroring from the pose, or drop the frame")
}
