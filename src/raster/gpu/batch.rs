//! Backward pass over the tiles: what the units of a cube share, and how many Gaussians they take together.

use super::pixel::{Four, PATCH};
use crate::backend::gpu::UNITS;
use burn_cubecl::cubecl::{self, prelude::*};

/// Sums over pixels of g times 1, u, v, u^2, u v, v^2.
pub(super) const MOMENTS: usize = 6;
/// These, and the sums over pixels of the absolute contributions to half the gradient of the projected centre, along x in units
/// of the inverse width: `|g u|`, `|g (v dv - slope u du)|`.
pub(super) const ABSOLUTE_MOMENTS: usize = 8;
/// Gaussians that a cube takes together.
pub(super) const BATCH: usize = 8;
/// Units that sum for one Gaussian.
pub(super) const LANES: usize = UNITS as usize / BATCH;
/// They are as many as the pixels of a patch.
const _: () = assert!(LANES == PATCH);

/// Floats that all units of a cube leave for each other: alpha' T and, for the moments, g of every pixel of a batch.
pub(super) const fn pairs_of(moments: usize) -> usize {
    (if moments > 0 { 2 } else { 1 }) * BATCH * UNITS as usize
}

/// Gaussians of the tile's list that a cube has loaded.
#[derive(CubeType)]
pub(super) struct Loaded {
    pub splats: Shared<[Four]>,
    pub values: Shared<[Four]>,
    pub entries: Shared<[u32]>,
    /// Whether a Gaussian may show in a patch.
    pub reached: Shared<[u32]>,
}

/// What the units of a cube leave for each other.
#[derive(CubeType)]
pub(super) struct Exchange {
    /// The gradient of the image at each pixel.
    pub d_pixels: Shared<[Four]>,
    /// `alpha' T` and, for the moments, g of each pixel of a batch; then sums of lanes.
    pub pairs: Shared<[f32]>,
    /// Whether a Gaussian of the batch contributes to a pixel of a patch.
    pub touched: Shared<[Atomic<u32>]>,
    /// Whether some unit still blends: one slot is written while another is read and the third is cleared.
    pub live: Shared<[Atomic<u32>]>,
}

/// The rows of one pass: a slab of the entries of all tiles.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Slab {
    pub first: u32,
    pub end: u32,
}
