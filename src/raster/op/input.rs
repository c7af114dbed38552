//! What the rasterizer takes and returns.

use super::splats::SplatTensors;
use crate::error::{Result, bail, ensure, invalid};
use burn::tensor::{DType, Tensor};

/// What [`crate::raster::rasterize`] renders. All tensors have one float type and live on one device.
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

impl RasterInput {
    /// Whether the screen-space gradient has the columns of AbsGS.
    pub(super) fn has_absolute_screen(&self) -> bool {
        let screen = self.screen.as_ref();
        screen.is_some_and(|screen| screen.dims()[1] == 4)
    }

    /// The geometry.
    pub(super) fn splats(&self) -> SplatTensors {
        SplatTensors {
            means: self.means.clone(),
            log_scales: self.log_scales.clone(),
            rotations: self.rotations.clone(),
            opacity_logits: self.opacity_logits.clone(),
        }
    }
}

/// What [`crate::raster::rasterize`] returns.
#[derive(Clone, Debug)]
pub struct RasterOutput {
    /// `[H, W, 3 + C]`, colour first when SH were given. The background is part of the colour.
    pub image: Tensor<3>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Tensor<2>,
    /// Radius in pixels of every Gaussian, `[N]`, without autodiff; 0 = not visible.
    pub radii: Tensor<1>,
}

/// Checks shapes and float types of `input`.
pub(super) fn check(input: &RasterInput) -> Result<()> {
    let [n] = input.opacity_logits.dims();
    shape("means", &input.means.dims(), &[n, 3])?;
    shape("log_scales", &input.log_scales.dims(), &[n, 3])?;
    shape("rotations", &input.rotations.dims(), &[n, 4])?;
    if input.sh.is_none() && input.features.is_none() {
        bail!(argument "raster input"; found "neither sh nor features";
            expected "at least one"; help "pass what to render");
    }
    if let Some(sh) = &input.sh {
        let terms = sh.dims()[1];
        ensure!(matches!(terms, 1 | 4 | 9 | 16), argument "raster input sh"; found "{terms} terms";
            expected "1, 4, 9 or 16"; help "pass (degree + 1)^2 terms");
        shape("sh", &sh.dims(), &[n, terms, 3])?;
    }
    if let Some(features) = &input.features {
        shape("features", &features.dims(), &[n, features.dims()[1]])?;
    }
    if let Some(screen) = &input.screen {
        let columns = if input.has_absolute_screen() { 4 } else { 2 };
        shape("screen", &screen.dims(), &[n, columns])?;
    }
    float_types(input)
}

fn shape(name: &str, found: &[usize], expected: &[usize]) -> Result<()> {
    ensure!(found == expected, argument "raster input {name}"; found "shape {found:?}"; expected "{expected:?}";
        help "pass tensors of one scene");
    Ok(())
}

fn float_types(input: &RasterInput) -> Result<()> {
    let dtype = input.means.dtype();
    ensure!(matches!(dtype, DType::F32 | DType::F64),
        argument "raster input"; found "{dtype:?}"; expected "f32 or f64";
        help "cast the tensors");
    let types = [
        ("log_scales", input.log_scales.dtype()),
        ("rotations", input.rotations.dtype()),
        ("opacity_logits", input.opacity_logits.dtype()),
        ("sh", input.sh.as_ref().map_or(dtype, Tensor::dtype)),
        (
            "features",
            input.features.as_ref().map_or(dtype, Tensor::dtype),
        ),
        ("screen", input.screen.as_ref().map_or(dtype, Tensor::dtype)),
    ];
    match types.into_iter().find(|(_, found)| *found != dtype) {
        None => Ok(()),
        Some((name, found)) => Err(invalid!(argument "raster input {name}"; found "{found:?}";
            expected "{dtype:?}, as the means have"; help "cast the tensors")),
    }
}
