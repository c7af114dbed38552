//! Camera paths: a smooth path through given cameras, a circle around what they look at, and an ellipse among them.
//!
//! All return [`super::camera::Camera`]s in the coordinates of the given ones.

mod interpolate;
mod orbit;
mod sway;

pub use self::interpolate::CameraPath;
pub use self::orbit::{Orbit, focus};
pub use self::sway::{is_front_facing, sway};

use super::camera::Camera;
use crate::error::{Error, Result, bail, ensure};

/// Checks that there is a camera and that each is usable.
fn check(cameras: &[Camera]) -> Result<()> {
    ensure!(!cameras.is_empty(), argument "cameras"; found "none"; expected "one or more";
        help "pass the cameras that the path is made from");
    for (i, camera) in cameras.iter().enumerate() {
        camera.check().map_err(|mut error| {
            if let Error::Argument { name, .. } = &mut error {
                name.insert_str(0, &format!("cameras[{i}]: "));
            }
            error
        })?;
        let rotation = camera.rotation;
        let off = (rotation.transpose() * rotation - glam::DMat3::IDENTITY).to_cols_array();
        if off.iter().any(|v| v.abs() > 1e-2) || rotation.determinant() < 0.0 {
            bail!(argument "cameras[{i}]: rotation"; found "{rotation}";
                expected "a rotation"; help "correct the pose");
        }
    }
    Ok(())
}
