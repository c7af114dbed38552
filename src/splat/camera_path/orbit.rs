//! A circle around what cameras look at.

use super::check;
use crate::error::{Result, ensure};
use crate::splat::camera::{Camera, level_up};
use crate::splat::median;
use glam::{DMat3, DVec3};
use nalgebra::Matrix3;
use std::f64::consts::{FRAC_PI_3, TAU};

/// Optical axes meet where the mean squared sine of their angles to the direction closest to all of them is at least this.
const MIN_SPREAD: f64 = 1e-3;
/// Smallest distance of an orbit from its box, as a share of the cameras' distance from it.
const MIN_DISTANCE: f64 = 0.1;

/// A circle of cameras that look at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Where the cameras look, world units.
    pub target: DVec3,
    /// Axis of the circle, unit length.
    pub up: DVec3,
    /// Direction from the axis to the first camera, perpendicular to [`Orbit::up`], unit length.
    pub start: DVec3,
    /// Distance of the circle from its axis, world units.
    pub radius: f64,
    /// Height of the circle above [`Orbit::target`] along [`Orbit::up`], world units.
    pub height: f64,
}

impl Orbit {
    /// Around the [`focus`] of `cameras`, or around `scene_center` where they have none. The axis is their [`level_up`]. Radius
    /// and height are the medians of the cameras, so that the circle stays among them. It starts on the side of the first one.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] without cameras, for an unusable one, and where the cameras stand above or at the centre.
    pub fn of_cameras(cameras: &[Camera], scene_center: DVec3) -> Result<Self> {
        check(cameras)?;
        Self::about(cameras, focus(cameras).unwrap_or(scene_center))
    }

    /// Around the box from `low` to `high`. The distance is such that the sphere around the box fits the field of view of the
    /// first camera, but at most the median distance of the cameras. The elevation is their median, at most 60 degrees.
    ///
    /// # Errors
    /// As [`Orbit::of_cameras`].
    pub fn of_box(cameras: &[Camera], low: DVec3, high: DVec3) -> Result<Self> {
        check(cameras)?;
        let orbit = Self::about(cameras, 0.5 * (low + high))?;
        let lens = &cameras[0];
        let sides = (lens.width as f64 / lens.fx).min(lens.height as f64 / lens.fy);
        let half_angle = (0.5 * sides).atan();
        let far = orbit.radius.hypot(orbit.height);
        let distance = (0.5 * low.distance(high) / half_angle.sin()).clamp(MIN_DISTANCE * far, far);
        let elevation = orbit
            .height
            .atan2(orbit.radius)
            .clamp(-FRAC_PI_3, FRAC_PI_3);
        Ok(Self {
            radius: distance * elevation.cos(),
            height: distance * elevation.sin(),
            ..orbit
        })
    }

    fn about(cameras: &[Camera], target: DVec3) -> Result<Self> {
        let up = level_up(cameras);
        let offsets = cameras.iter().map(|camera| camera.center - target);
        let height = median(offsets.clone().map(|o| o.dot(up)));
        let radius = median(offsets.map(|o| o.reject_from_normalized(up).length()));
        let start = (cameras[0].center - target)
            .reject_from_normalized(up)
            .try_normalize();
        let orbit = Self {
            target,
            up,
            start: start.unwrap_or(up.any_orthonormal_vector()),
            radius,
            height,
        };
        orbit.check()?;
        Ok(orbit)
    }

    fn check(&self) -> Result<()> {
        let Self {
            target,
            up,
            start,
            radius,
            height,
        } = *self;
        let is_finite =
            target.is_finite() && height.is_finite() && (radius + height.abs()).is_finite();
        // A smaller circle is a point, except for rounding.
        ensure!(is_finite && radius > 1e-12 * (height.abs() + target.length()) && radius > 0.0, argument "orbit";
            found "radius {radius:.3e} around {target}, {height:.3e} above it";
            expected "a circle"; help "give cameras that stand around something");
        let off = [up.length() - 1.0, start.length() - 1.0, up.dot(start)];
        ensure!(!off.iter().any(|off| off.is_nan() || off.abs() > 1e-6),
            argument "orbit"; found "up {up}, start {start}";
            expected "perpendicular unit vectors"; help "normalise them");
        Ok(())
    }

    /// `count` cameras along the whole circle with the intrinsics of `lens`, evenly spaced and counter-clockwise as seen from the
    /// tip of [`Orbit::up`]. The last is one step before the first, so that a film of them loops.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for directions that are not perpendicular unit vectors, or no radius above 0.
    pub fn frames(&self, lens: &Camera, count: usize) -> Result<Vec<Camera>> {
        self.check()?;
        let side = self.up.cross(self.start);
        let camera = |i: usize| {
            let (sin, cos) = (TAU * i as f64 / count as f64).sin_cos();
            let offset = self.height * self.up + self.radius * (cos * self.start + sin * side);
            // The tangent of the circle, which points right for a camera that looks inwards.
            let right = cos * side - sin * self.start;
            let forward = -offset.normalize();
            let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
            Camera {
                rotation,
                center: self.target + offset,
                ..lens.clone()
            }
        };
        Ok((0..count).map(camera).collect())
    }
}

/// The point closest to all optical axes by least squares: sum of (I - d d^T) (x - c) = 0 for centres c and unit directions d.
///
/// `None` where the axes are nearly parallel, as with one camera. Also `None` where the point lies behind half of the cameras or
/// more, as in photos taken outwards from one place.
pub fn focus(cameras: &[Camera]) -> Option<DVec3> {
    let count = cameras.len() as f64;
    // Relative to the mean, because scenes may lie far from the origin.
    let mean = cameras
        .iter()
        .map(|camera| camera.center / count)
        .sum::<DVec3>();
    let mut normal = DMat3::ZERO;
    let mut right = DVec3::ZERO;
    for camera in cameras {
        let d = forward(camera).try_normalize()?;
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        normal += across;
        right += across * (camera.center - mean);
    }
    let least = Matrix3::from_column_slice(&normal.to_cols_array())
        .symmetric_eigenvalues()
        .min();
    if least.is_nan() || least < MIN_SPREAD * count {
        return None;
    }
    let point = normal.inverse() * right + mean;
    let in_front = cameras
        .iter()
        .filter(|camera| (point - camera.center).dot(forward(camera)) > 0.0)
        .count();
    (point.is_finite() && 2 * in_front > cameras.len()).then_some(point)
}

fn forward(camera: &Camera) -> DVec3 {
    camera.rotation.transpose().z_axis
}
