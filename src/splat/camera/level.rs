//! The up direction of a scene, estimated from its cameras.

use super::Camera;
use glam::{DMat3, DVec3};
use nalgebra::Matrix3;

/// Mean squared sine of the cameras' roll (18 degrees) above which they were not held level, such as with portrait photos among
/// landscape ones.
const MAX_ROLL: f64 = 0.1;
/// Weight of the mean of the cameras' up directions relative to their levelness, for one camera and for very many: the variance
/// of hand-held roll (3 degrees) over that of a common tilt (10 degrees).
const MEAN: [f64; 2] = [0.1, 1e-3];
/// Cameras look along one line with any roll where the mean up direction is shorter than the first, and the mean viewing
/// direction longer than the second.
const ALONG_ONE_LINE: [f64; 2] = [0.3, 0.9];

/// World direction that points up, unit length; +z without cameras.
///
/// People hold cameras level, so up is perpendicular to the rows of the images, by least squares, however the cameras are tilted.
/// The mean of the cameras' up directions decides what this leaves open, such as the slope of a row of cameras. It decides
/// everything where the cameras are not level, as with photos that are stored sideways. Where that mean cancels out, cameras that
/// look along one line are assumed to look down, as from a drone. Otherwise the up direction of the first camera counts.
pub fn level_up(cameras: &[Camera]) -> DVec3 {
    let count = cameras.len() as f64;
    // The rows of the rotation are the axes of the camera in the world.
    let mean_of = |axis: usize| cameras.iter().map(|c| c.rotation.row(axis)).sum::<DVec3>() / count;
    // Image rows run down.
    let up = -mean_of(1);
    let forward = mean_of(2);
    if up.length() < ALONG_ONE_LINE[0] && forward.length() > ALONG_ONE_LINE[1] {
        return -forward.normalize();
    }
    let some = if up.length() > 1e-3 {
        Some(up)
    } else {
        cameras.first().map(|c| -c.rotation.row(1))
    };
    let mean_up = some.and_then(DVec3::try_normalize).unwrap_or(DVec3::Z);

    let mut spread = DMat3::ZERO;
    for right in cameras.iter().map(|c| c.rotation.row(0)) {
        spread +=
            DMat3::from_cols(right * right.x, right * right.y, right * right.z) * count.recip();
    }
    if !spread.is_finite() {
        return mean_up;
    }
    let roll = Matrix3::from_column_slice(&spread.to_cols_array())
        .symmetric_eigenvalues()
        .min();
    if roll.is_nan() || roll > MAX_ROLL {
        return mean_up;
    }
    let weight = (MEAN[0] / count.max(1.0)).max(MEAN[1]);
    let ridge = spread + DMat3::from_diagonal(DVec3::splat(weight));
    (ridge.inverse() * mean_up)
        .try_normalize()
        .unwrap_or(mean_up)
}
