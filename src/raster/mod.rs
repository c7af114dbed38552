//! The rasterizer: N-channel alpha blending of 3D Gaussians, its adjoint, and the handwritten backward pass.
//!
//! With frozen geometry rendering is a constant sparse linear map `S = W s`, `W[p, i] = alpha'_i(p) T_i(p)`
//! (Eq. 3-4). [`Projected`] holds what one view needs for it (projection, depth order, tile lists), and applies it both
//! ways: [`Projected::blend`] and [`Projected::blend_adjoint`]. [`rasterize`] is the burn operation with gradients to
//! every input.
//!
//! Kernels are generic over `f32` and `f64`; geometry is computed in `f64` in both, so that the depth order and the
//! tile lists of an `f32` render are those of its `f64` reference. Results do not depend on the number of threads.
//! They may differ in the last bits between machines with and without fused multiply-add.

mod backward;
mod blend;
mod channel_blocks;
mod counter;
mod footprint;
mod geometry;
#[cfg(feature = "cube")]
mod gpu;
mod labels;
mod op;
mod outline;
mod pairs;
mod projected;
mod projection;
mod settings;
mod sh;
mod tile_loop;
mod tile_map;
mod tiles;
mod weights;

pub use self::backward::SplatGradients;
pub(crate) use self::geometry::{Viewpoint, ZERO_QUATERNION};
pub use self::op::{
    FrozenBackend, FrozenCall, FrozenTensors, Lifted, ListCount, ListSummary, Radii, RasterBackend,
    RasterCall, RasterInput, RasterOutput, RasterTensors, SplatTensors, SplatView, rasterize,
    rasterize_on_host, rasterize_with_room, room_for,
};
pub use self::projected::{Blended, Projected, Rendered, render};
pub use self::settings::{PairCounts, Settings, Splats, Stats};
pub(crate) use self::sh::basis as sh_basis;
pub use self::sh::eval_sh;
pub use self::tile_map::{Positions, TilePairs};
