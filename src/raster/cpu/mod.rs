//! The kernels of the rasterizer for the CPU.
//!
//! Kernels are generic over `f32` and `f64`. Geometry is computed in `f64` in both, so that the depth order and the
//! tile lists of an `f32` render are those of its `f64` reference. Results do not depend on the number of threads.
//! They may differ in the last bits between instruction sets.

mod backward;
mod blend;
mod channel_blocks;
mod disc_pixels;
pub(super) mod footprint;
pub(super) mod geometry;
mod labels;
mod linear_map;
mod moments;
mod outline;
mod pairs;
mod parameter_gradients;
mod pixel_gradients;
pub(super) mod projected;
mod projection;
mod render;
pub(super) mod sh;
mod tile_loop;
mod tiles;
mod weights;

pub use self::parameter_gradients::SplatGradients;
pub use self::pixel_gradients::PixelGradients;
pub use self::projected::{Blended, Projected};
pub use self::render::{Rendered, render};
