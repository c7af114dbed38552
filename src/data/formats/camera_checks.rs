//! Limits and checks for the cameras of all formats.

use crate::error::{Error, Result, ensure, invalid};
use crate::splat::camera::Camera;
use glam::{DMat3, DMat4};
use std::ops::RangeInclusive;
use std::path::Path;

/// Range of plausible focal lengths, pixels.
pub(crate) const FOCAL: RangeInclusive<f64> = 1e-3..=1e9;
/// Largest plausible distance of a principal point from the image corner, pixels.
pub(crate) const MAX_PIXELS: f64 = 1e9;

/// Largest coordinate in the world: its square is finite in f32 as well.
const MAX_WORLD: f64 = 1e15;

/// Fields of view, degrees, that no lens has without distortion.
const FIELDS_OF_VIEW: RangeInclusive<f64> = 0.05..=179.5;
/// Largest distance of a principal point from the middle of the photo, in sides of the photo.
const MAX_OFFSET: f64 = 100.0;

/// The fault of a frame whose intrinsics no photo has.
pub(crate) fn check_intrinsics(path: &Path, frame: &str, camera: &Camera) -> Result<()> {
    let sides = [
        (camera.fx, camera.cx, camera.width),
        (camera.fy, camera.cy, camera.height),
    ];
    for (focal, center, length) in sides.map(|(f, c, length)| (f, c, length as f64)) {
        let angle = 2.0 * (0.5 * length / focal).atan().to_degrees();
        let offset = (center - 0.5 * length).abs();
        ensure!(FIELDS_OF_VIEW.contains(&angle) && offset <= MAX_OFFSET * length, path, "{frame}: intrinsics";
            found "focal length {focal}, principal point {center} for {length} pixels";
            expected "a field of view from 0.05 to 179.5 degrees, and a principal point near the photo";
            help "give them in pixels of these photos, or calibrate again");
    }
    Ok(())
}

/// Whether a number is finite in f32 as well.
pub(crate) fn fits_f32(value: f64) -> bool {
    (value as f32).is_finite()
}

/// Whether a number may be a coordinate in the world.
pub(crate) fn is_coordinate(value: f64) -> bool {
    value.abs() <= MAX_WORLD
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
