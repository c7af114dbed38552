//! Pictures of a scene.

use super::projected::{Blended, Projected};
use super::sh::Harmonics;
use crate::error::Result;
use crate::raster::settings::Settings;
use crate::splat::Gaussians;
use crate::splat::camera::Camera;

/// A picture of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Colour, `[H, W, 3]`, background included, not clamped.
    pub rgb: Vec<f32>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Vec<f32>,
}

/// Renders the colours of `gaussians` seen by `camera` over `background`.
///
/// # Errors
/// As [`Projected::new`], and [`crate::Error::NonFinite`] for the SH coefficients.
pub fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<Rendered> {
    let projected = Projected::new(&gaussians.splats(), camera, settings)?;
    let degree = gaussians.sh_degree;
    let means = gaussians.means.as_flattened();
    let harmonics = Harmonics::new(means, &gaussians.sh, degree, degree, camera);
    let colours = harmonics.colours(projected.radii())?;
    let Blended {
        image: mut rgb,
        transmittance,
    } = projected.blend(&colours, 3);
    for (pixel, &t) in rgb.chunks_exact_mut(3).zip(&transmittance) {
        for (value, behind) in pixel.iter_mut().zip(background) {
            *value += t * behind;
        }
    }
    Ok(Rendered { rgb, transmittance })
}
