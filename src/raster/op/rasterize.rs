//! [`rasterize`], with gradients to every input.

use super::backend::RasterBackend;
use super::input::{RasterInput, RasterOutput, check};
use super::reference;
use super::tensors::{RasterCall, RasterPass};
use crate::error::Result;
use crate::ops::CustomOp;
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn::backend::Dispatch;
use burn::tensor::Tensor;
use std::sync::Arc;

/// Renders `input` seen by `camera` (Eq. 1-4), with gradients to every input.
///
/// `background` is added to the colour channels as `T b`, and gradients flow through it. A loss on the transmittance itself costs a
/// second backward pass. The sums of absolute values of both are then `sum |dI| + sum |dT|` over the pixels, not `sum |dI + dT|`. The
/// SH gradient includes the path of the viewing direction to the means.
///
/// # Errors
/// [`Error::Argument`](crate::Error::Argument) for shapes or float types that disagree, neither `sh` nor `features`, or an SH
/// degree above 3; [`Error::NonFinite`](crate::Error::NonFinite) for a NaN or an infinity in any input; otherwise as
/// [`Projected::new`](crate::raster::Projected::new).
pub fn rasterize(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    check(&input)?;
    if CustomOp::Raster.is_replaced() {
        return reference::rasterize(input, camera, settings, background);
    }
    let call = RasterCall {
        camera: camera.clone(),
        settings: *settings,
        background: background.map(f64::from),
        sh_degree: input.sh.as_ref().map(|sh| sh.dims()[1].isqrt() - 1),
        active_sh_degree: input.active_sh_degree,
        absolute_screen: input.has_absolute_screen(),
    };
    let splats = input.splats();
    let tensors = splats.with_values(input.sh, input.features, input.screen);
    match Dispatch::raster_forward(tensors, Arc::new(call)) {
        RasterPass::Done {
            image,
            transmittance,
            radii,
            ..
        } => Ok(RasterOutput {
            image: Tensor::from_dispatch(image),
            transmittance: Tensor::from_dispatch(transmittance),
            radii: Tensor::from_dispatch(radii).inner(),
        }),
        RasterPass::Failed(error) => Err(error),
    }
}
