//! The rasterizer as burn operations: [`rasterize`] with gradients to every input, and [`SplatView`], which blends with
//! frozen geometry and applies the adjoint.
//!
//! The backend trait is in `backend`, its implementations are in `cpu`, `gpu` and `autodiff`. A forward pass returns what its
//! backward pass needs as a typed value, which the autodiff node keeps.

mod autodiff;
mod backend;
mod check;
mod cpu;
#[cfg(feature = "cube")]
mod gpu;
mod labels;
mod splats;
mod tile_lists;
mod view;

pub(crate) use self::labels::{GaussianLabels, Largest, one_hot};
pub use self::splats::SplatTensors;
pub use self::tile_lists::{ListCount, tile_capacity};
pub use self::view::{Lifted, SplatView};

use self::backend::{RasterBackend, RasterCall, RasterPass, RasterTensors};
use super::settings::Settings;
use crate::error::Result;
use crate::splat::camera::Camera;
use burn::backend::Dispatch;
use burn::tensor::Tensor;
use std::sync::Arc;

/// What [`rasterize`] renders. All tensors have one float type and live on one device.
#[derive(Clone, Debug)]
pub struct RasterInput {
    /// `[N, 3]`, world units.
    pub means: Tensor<2>,
    /// `[N, 3]`, natural logarithms.
    pub log_scales: Tensor<2>,
    /// `[N, 4]` (w, x, y, z), not normalised.
    pub rotations: Tensor<2>,
    /// `[N]`.
    pub opacity_logits: Tensor<1>,
    /// `[N, K, 3]`, `K = (degree + 1)^2`, degree 0 to 3: adds three colour channels.
    pub sh: Option<Tensor<3>>,
    /// Highest SH degree in use. Terms above it are left out and get a zero gradient.
    pub active_sh_degree: usize,
    /// `[N, C]`: adds C channels after the colour.
    pub features: Option<Tensor<2>>,
    /// `[N, 2]` or `[N, 4]`, any values. Its gradient is the screen-space gradient `(dL/du W/2, dL/dv H/2)`. Four columns add
    /// the sums over pixels of the absolute values of both (AbsGS); a GPU has these for up to 8 channels.
    pub screen: Option<Tensor<2>>,
}

/// What [`rasterize`] returns.
#[derive(Clone, Debug)]
pub struct RasterOutput {
    /// `[H, W, 3 + C]`, colour first when SH were given. The background is part of the colour.
    pub image: Tensor<3>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Tensor<2>,
    /// Radius in pixels of every Gaussian, `[N]`, without autodiff; 0 = not visible.
    pub radii: Tensor<1>,
    /// The values of a [`ListCount`], `[3]`, without autodiff.
    pub tile_lists: Tensor<1>,
}

/// Renders `input` seen by `camera` (Eq. 1-4), with gradients to every input.
///
/// `background` is added to the colour channels as `T b`. Gradients also flow from the transmittance. The SH gradient
/// includes the path of the viewing direction to the means.
///
/// # Errors
/// [`Error::Argument`](crate::Error::Argument) for shapes or float types that disagree, neither `sh` nor `features`, or an SH
/// degree above 3; [`Error::NonFinite`](crate::Error::NonFinite) for a NaN or an infinity in any input; otherwise as
/// [`Projected::new`](super::Projected::new).
pub fn rasterize(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    rasterize_with_capacity(input, camera, settings, background, None)
}

/// [`rasterize`] without waiting for a GPU.
///
/// A GPU counts the entries of the tile lists, and the host reads the count to allocate the lists. With a `tile_capacity` the
/// host allocates that many entries at once (about 28 bytes each while lists are sorted) and reads nothing. Read
/// [`RasterOutput::tile_lists`] later, together with other results: if the [`ListCount`] is not sound, neither the output nor
/// its gradients are valid. Then call again without a capacity, for the image or for the error that names the non-finite input.
/// With enough capacity the output has the same bits as that of [`rasterize`]. The CPU ignores the capacity, and so does a GPU
/// whose largest buffer holds fewer entries.
///
/// # Errors
/// As [`rasterize`]. Non-finite inputs are an error only without a capacity.
pub fn rasterize_with_capacity(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
    tile_capacity: Option<usize>,
) -> Result<RasterOutput> {
    let sizes = check::sizes(&input)?;
    let call = RasterCall {
        camera: camera.clone(),
        settings: *settings,
        background: background.map(f64::from),
        has_sh: input.sh.is_some(),
        has_features: input.features.is_some(),
        sh_degree: sizes.sh_terms.isqrt() - 1,
        active_sh_degree: input.active_sh_degree,
        absolute_screen: sizes.absolute_screen,
        tile_capacity,
    };
    let place = (&input.means.device(), input.means.dtype());
    let absent = || Tensor::<2>::zeros([sizes.gaussians, 0], place).into_dispatch();
    let tensors = RasterTensors {
        means: input.means.into_dispatch(),
        log_scales: input.log_scales.into_dispatch(),
        rotations: input.rotations.into_dispatch(),
        opacity_logits: input.opacity_logits.into_dispatch(),
        sh: input.sh.map_or_else(absent, Tensor::into_dispatch),
        features: input.features.map_or_else(absent, Tensor::into_dispatch),
        screen: input.screen.map_or_else(absent, Tensor::into_dispatch),
    };
    match Dispatch::raster_forward(tensors, Arc::new(call)) {
        RasterPass::Done {
            image,
            transmittance,
            radii,
            tile_lists,
            ..
        } => Ok(RasterOutput {
            image: Tensor::from_dispatch(image),
            transmittance: Tensor::from_dispatch(transmittance),
            radii: plain(Tensor::from_dispatch(radii)),
            tile_lists: plain(Tensor::from_dispatch(tile_lists)),
        }),
        RasterPass::Failed(error) => Err(error),
    }
}

/// `tensor` without autodiff.
fn plain(tensor: Tensor<1>) -> Tensor<1> {
    if tensor.device().is_autodiff() {
        tensor.inner()
    } else {
        tensor
    }
}
