//! Which way is up, as the cameras tell.

use super::Camera;
use glam::{DMat3, DVec3};
use nalgebra::Matrix3;

/// Mean squared sine of the cameras' roll beyond which they were not held level (18 degrees): turned photos among
/// upright ones.
const LARGEST_ROLL: f64 = 0.1;
/// How much the mean of the cameras' up directions counts beside their levelness: the variance of a hand's roll (3
/// degrees) beside that of a common tilt (10 degrees), of one camera and of very many.
const MEAN: [f64; 2] = [0.1, 1e-3];
/// Lengths of the mean up and viewing directions, below and above which cameras look along one line and every way round.
const ALONG_ONE_LINE: [f64; 2] = [0.3, 0.9];

/// World direction that points up, unit length.
///
/// People hold cameras level, so it is perpendicular to the rows of their images, by least squares, whichever way they
/// are tilted. What this leaves open, the slope of a row of cameras say, is decided by the mean of their own up directions,
/// which a common tilt takes along; so is all where they are not level, as with photos that are stored sideways. Where that
/// mean cancels out, cameras that look along one line are taken to look down, as from a drone (not up, nor straight ahead with
/// every other photo upside down), and otherwise it is that of the first.
/// +z without cameras.
pub fn level_up(cameras: &[Camera]) -> DVec3 {
    let count = cameras.len() as f64;
    // Variant by row, the axes of a camera in the world.
    let mean_of = |axis: usize| cameras.iter().map(|c| c.rotation.row(axis)).sum::<DVec3>() / count;
    // Image rows run down.
    let (up, forward) = (-mean_of(1), mean_of(2));
    if up.length() < ALONG_ONE_LINE[0] && forward.length() > ALONG_ONE_LINE[1] {
        return -forward.normalize();
    }
    let some = if up.length() > 1e-3 {
        Some(up)
    } else {
        cameras.first().map(|c| -c.rotation.row(1))
    };
    let own = some.and_then(DVec3::try_normalize).unwrap_or(DVec3::Z);

    let mut spread = DMat3::ZERO;
    for right in cameras.iter().map(|c| c.rotation.row(0)) {
        spread +=
            DMat3::from_cols(right * right.x, right * right.y, right * right.z) * count.recip();
    }
    let roll = match spread.is_finite() {
        true => Matrix3::from_column_slice(&spread.to_cols_array())
            .symmetric_eigenvalues()
            .min(),
        false => f64::NAN,
    };
    if roll.is_nan() || roll > LARGEST_ROLL {
        return own;
    }
    let weight = (MEAN[0] / count.max(1.0)).max(MEAN[1]);
    let ridge = spread + DMat3::from_diagonal(DVec3::splat(weight));
    (ridge.inverse() * own).try_normalize().unwrap_or(own)
}
