//! The rasterizer: N-channel alpha blending of 3D Gaussians, its adjoint, and the handwritten backward pass.
//!
//! With frozen geometry, rendering is a constant sparse linear map `S = W s`, `W[p, i] = alpha'_i(p) T_i(p)` (Eq. 3-4).
//! [`Projected`] holds the map of one view as projection, depth order and tile lists. [`Projected::blend`] applies `W`,
//! [`Projected::blend_adjoint`] its transpose. [`rasterize`] is the burn operation with gradients to every input.
//!
//! `cpu` and `gpu` hold the kernels, `op` the burn operations over both.

mod cpu;
#[cfg(feature = "cube")]
mod gpu;
mod op;
mod settings;

pub use self::cpu::{Blended, PixelGradients, Projected, Rendered, SplatGradients, render};
pub(crate) use self::op::{GaussianLabels, Largest};
pub use self::op::{RasterInput, RasterOutput, SplatTensors, SplatView, rasterize};
pub use self::settings::{Settings, Splats};
