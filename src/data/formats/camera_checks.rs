//! Limits and checks for the cameras of all formats.

use crate::error::{Error, Result, bail, ensure, invalid};
use crate::splat::camera::Camera;
use glam::{DMat3, DMat4, DVec4};
use std::ops::RangeInclusive;
use std::path::Path;

/// Range of plausible focal lengths, pixels.
pub(crate) const FOCAL: RangeInclusive<f64> = 1e-3..=1e9;
/// Largest plausible distance of a principal point from the image corner, pixels.
const MAX_PIXELS: f64 = 1e9;

/// Largest coordinate in the world: its square is finite in f32 as well.
const MAX_WORLD: f64 = 1e15;

/// Fields of view, degrees, that no lens has without distortion.
const FIELDS_OF_VIEW: RangeInclusive<f64> = 0.05..=179.5;
/// Largest distance of a principal point from the middle of the photo, in sides of the photo.
const MAX_OFFSET: f64 = 100.0;

/// A side of a photo, in pixels, that `field` of the file `path` gave.
pub(crate) fn side(path: &Path, field: &str, side: f64) -> Result<usize> {
    ensure!(side.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&side), path, "{field}"; found "{side:?}";
        expected "a whole number of pixels, at least 1"; help "correct the size");
    Ok(side as usize)
}

/// Refuses a focal length, in pixels, that `field` of the file `path` gave.
pub(crate) fn check_focal(path: &Path, field: &str, focal: f64, help: &str) -> Result<()> {
    ensure!(FOCAL.contains(&focal), path, "{field}"; found "{focal:?} pixels";
        expected "a positive focal length, 0.001 to 1e9 pixels";
        help "{help}");
    Ok(())
}

/// Refuses a coordinate of a principal point, in pixels, that `field` of the file `path` gave.
pub(crate) fn check_center(path: &Path, field: &str, center: f64, help: &str) -> Result<()> {
    ensure!(center.abs() <= MAX_PIXELS, path, "{field}"; found "{center:?}"; expected "pixels from the image corner";
        help "{help}");
    Ok(())
}

/// The fault of a frame whose intrinsics no photo has.
pub(crate) fn check_intrinsics(path: &Path, frame: &str, camera: &Camera) -> Result<()> {
    if let Some(found) = odd_intrinsics(camera, &FIELDS_OF_VIEW, MAX_OFFSET) {
        bail!(path, "{frame}: intrinsics"; found "{found}";
            expected "a field of view from 0.05 to 179.5 degrees, and a principal point near the photo";
            help "give them in pixels of these photos, or calibrate again");
    }
    Ok(())
}

/// The intrinsics along the first axis where the field of view, in degrees, is not one of `fields_of_view`, or where the principal
/// point is further than `max_offset` sides of the photo from its middle.
pub(crate) fn odd_intrinsics(
    camera: &Camera,
    fields_of_view: &RangeInclusive<f64>,
    max_offset: f64,
) -> Option<String> {
    let axes = [
        ("x", camera.fx, camera.cx, camera.width),
        ("y", camera.fy, camera.cy, camera.height),
    ];
    axes.into_iter().find_map(|(axis, focal, center, side)| {
        let side = side as f64;
        let angle = 2.0 * (0.5 * side / focal).atan().to_degrees();
        let is_centred = (center - 0.5 * side).abs() <= max_offset * side;
        (!is_centred || !fields_of_view.contains(&angle)).then(|| {
            format!(
                "focal length {focal} (a field of view of {angle:.1} degrees) and principal point {center} for the {side} pixels \
                 along {axis}"
            )
        })
    })
}

/// Whether a number may be a coordinate in the world.
pub(crate) fn is_coordinate(value: f64) -> bool {
    value.abs() <= MAX_WORLD
}

/// The camera that `with_pose` makes of a camera-to-world matrix in axes of its own, which `field` of the file `path` gave.
///
/// # Errors
/// [`Error::Input`] where the matrix has numbers that are not coordinates, has a last row other than 0, 0, 0, 1, or is no
/// rotation and translation.
pub(crate) fn posed(
    path: &Path,
    field: &str,
    pose: &DMat4,
    with_pose: impl Fn(&DMat4) -> Option<Camera>,
) -> Result<Camera> {
    let rows = pose.transpose().to_cols_array();
    if let Some(i) = rows.iter().position(|value| !is_coordinate(*value)) {
        bail!(path, "{field}"; found "{:?} in row {}, column {}", rows[i], i / 4, i % 4;
            expected "finite numbers, no larger than places may be"; help "export the pose again, or drop the frame");
    }
    let last = pose.row(3);
    ensure!(last.abs_diff_eq(DVec4::W, 1e-6), path, "{field}"; found "last row {:?}", last.to_array();
        expected "[0, 0, 0, 1]"; help "write the matrix by rows, its translation at the end of each, or drop the frame");
    with_pose(pose).ok_or_else(|| not_a_rotation(path, field, pose, with_pose))
}

/// The error for a pose that `with_pose` refuses. Exporters of Blender leave the scale of the object that a camera belongs to in
/// its matrix.
fn not_a_rotation(
    path: &Path,
    field: &str,
    pose: &DMat4,
    with_pose: impl Fn(&DMat4) -> Option<Camera>,
) -> Error {
    let m = DMat3::from_mat4(*pose);
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|axis| axis.length());
    let determinant = m.determinant();
    let mut found = format!("column lengths {lengths:.4?}, determinant {determinant:.4}");
    let mut help = "remove scale, shear and mirroring from the pose, or drop the frame".to_owned();
    let scale = lengths[0];
    if with_pose(&DMat4::from_mat3(m * scale.recip())).is_some() {
        found += &format!(", which is a rotation times {scale:.6}");
        help = format!("divide its first three columns by {scale:.6}; the translation stays");
    }
    invalid!(path, "{field}"; found "{found}";
        expected "a rotation (orthonormal columns, determinant +1) and a translation"; help "{help}")
}
