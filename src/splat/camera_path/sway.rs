//! A path that sways among cameras that look one way.

use super::{check, focus};
use crate::error::Result;
use crate::splat::camera::{Camera, level_up};
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// Cameras look one way if the mean of the cosines of their directions to the mean direction is at least this. It is 0.83 for a
/// row of cameras that turn by 60 degrees to either side.
const MIN_COSINE: f64 = 0.8;

/// Whether the cameras look one way, as at a wall: an orbit would pass behind what they show.
pub fn is_front_facing(cameras: &[Camera]) -> bool {
    mean(cameras, |camera| camera.rotation.row(2)).length() >= MIN_COSINE
}

/// `count` cameras on an ellipse about the mean of `cameras`, once around, with the intrinsics of the first one. Its half axes to
/// the right and up are the standard deviations of the cameras, so that it stays among them. All look at the point ahead that is
/// as far as the [`focus`], or as `scene_center` where they have none; straight ahead if that lies behind them. The last is one
/// step before the first, so that a film of them loops.
///
/// # Errors
/// [`crate::Error::Argument`] without cameras, and for an unusable one.
pub fn sway(cameras: &[Camera], scene_center: DVec3, count: usize) -> Result<Vec<Camera>> {
    check(cameras)?;
    let center = mean(cameras, |camera| camera.center);
    let ahead = mean(cameras, |camera| camera.rotation.row(2)).try_normalize();
    let ahead = ahead.unwrap_or(cameras[0].rotation.row(2));
    let up = level_up(cameras)
        .reject_from_normalized(ahead)
        .try_normalize();
    let up = up.unwrap_or(ahead.any_orthonormal_vector());
    let right = ahead.cross(up);
    let deviation = |axis: DVec3| {
        let offset = |camera: &Camera| DVec3::splat((camera.center - center).dot(axis).powi(2));
        mean(cameras, offset).x.sqrt() * axis
    };
    let (wide, high) = (deviation(right), deviation(up));
    let depth = (focus(cameras).unwrap_or(scene_center) - center).dot(ahead);
    let camera = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
        let offset = sin * wide + cos * high;
        let forward = if depth > 0.0 {
            (depth * ahead - offset).normalize()
        } else {
            ahead
        };
        let across = forward.cross(up).normalize();
        Camera {
            rotation: DMat3::from_cols(across, forward.cross(across), forward).transpose(),
            center: center + offset,
            ..cameras[0].clone()
        }
    };
    Ok((0..count).map(camera).collect())
}

fn mean(cameras: &[Camera], value: impl Fn(&Camera) -> DVec3) -> DVec3 {
    cameras.iter().map(value).sum::<DVec3>() / cameras.len().max(1) as f64
}
