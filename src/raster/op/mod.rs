//! The rasterizer as burn operations: [`rasterize`] with gradients to every input, and [`SplatView`], which blends with
//! frozen geometry and applies the adjoint.
//!
//! The backend trait is in `backend`, its kernels are in `cpu` and `gpu`. A forward pass returns what its
//! backward pass needs as a typed value, which the autodiff node keeps.

mod backend;
mod cpu;
#[cfg(feature = "cube")]
mod gpu;
mod input;
mod labels;
mod rasterize;
mod reference;
mod splats;
mod tensors;
mod view;

pub use self::input::{RasterInput, RasterOutput};
pub(crate) use self::labels::{GaussianLabels, Largest};
pub use self::rasterize::rasterize;
pub use self::splats::SplatTensors;
pub use self::view::SplatView;
