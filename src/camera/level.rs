//! Which way is up, as the cameras tell.

use super::Camera;
use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SymmetricEigen};

/// Mean squared sine of the cameras' roll beyond which they were not held level (18 degrees): turned photos among upright ones.
const LARGEST_ROLL: f64 = 0.1;
/// The mean of the cameras' up directions counts this much beside their levelness: a part in a thousand, for cameras in a row
/// whose levelness leaves the slope of the row open.
const MEAN: f64 = 1e-3;
/// Cosine with the vertical below which that mean says nothing about its sense: cameras that look straight down or up.
const UPRIGHT: f64 = 0.2;

/// World direction that points up, unit length: people hold cameras level, so it is perpendicular to the rows of their images,
/// by least squares, whichever way they are tilted; in the sense of the images' upper rims, or against the viewing direction where all
/// look along the vertical. The mean of the cameras' own up directions, which a common tilt takes along, decides only what this leaves
/// open, and all where the cameras are not level; where it cancels out that of the first. +z without cameras.
pub fn level_up(cameras: &[Camera]) -> DVec3 {
    let count = cameras.len() as f64;
    let sum = |axis: fn(&DMat3) -> DVec3| cameras.iter().map(|c| axis(&c.rotation.transpose())).sum::<DVec3>() / count;
    // Image rows run down.
    let mean = -sum(|to_world| to_world.y_axis);
    let some = if mean.length() > 1e-3 { Some(mean) } else { cameras.first().map(|c| -c.rotation.row(1)) };
    let own = some.and_then(DVec3::try_normalize).unwrap_or(DVec3::Z);

    let mut spread = DMat3::ZERO;
    for right in cameras.iter().map(|c| c.rotation.row(0)) {
        spread += DMat3::from_cols(right * right.x, right * right.y, right * right.z) * count.recip();
    }
    if !spread.is_finite() {
        return own;
    }
    let axes = SymmetricEigen::new(Matrix3::from_column_slice(&spread.to_cols_array()));
    let least = axes.eigenvalues.imin();
    let vertical = DVec3::from_slice(axes.eigenvectors.column(least).as_slice());
    let others = (0..3).filter(|&i| i != least).map(|i| axes.eigenvalues[i]).fold(f64::INFINITY, f64::min);
    if axes.eigenvalues[least] > LARGEST_ROLL {
        return own;
    }
    if mean.dot(vertical).abs() < UPRIGHT && others > LARGEST_ROLL {
        let forward = sum(|to_world| to_world.z_axis).dot(vertical);
        return if forward == 0.0 { own } else { -vertical * forward.signum() };
    }
    let ridge = spread + DMat3::from_diagonal(DVec3::splat(MEAN));
    (ridge.inverse() * own).try_normalize().unwrap_or(own)
}
