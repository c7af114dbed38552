//! The contributing pairs of a view, tile by tile, for linear reads of the image other than pixel by pixel.

use super::blend::Tile;
use super::footprint::{TILE, fresh_transmittance};
use super::projected::Projected;
use super::tile_pairs::Pairs;
use crate::ops::Real;
use rayon::prelude::*;

/// Contributing pairs of one tile, Gaussian by Gaussian, front to back.
pub struct TilePairs<'a, E> {
    /// Column and row of the tile's first pixel.
    pub origin: [usize; 2],
    ids: &'a [u32],
    ranks: &'a [u32],
    pairs: Pairs<E, false>,
}

impl<E: Real> TilePairs<'_, E> {
    /// Pixels along a tile's edge.
    pub const EDGE: usize = TILE;

    /// Gaussians of the tile that were looked at before all its pixels ended.
    pub fn len(&self) -> usize {
        self.pairs.ends.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The `i`-th Gaussian's index in the scene, the pixels it contributes to (`row * EDGE + column` within the tile,
    /// ascending by row) and its weights alpha' T there.
    pub fn gaussian(&self, i: usize) -> (u32, &[u16], &[E]) {
        let range = self.pairs.range(i);
        (self.ids[self.ranks[i] as usize], &self.pairs.pixels[range.clone()], &self.pairs.weights[range])
    }
}

impl<E: Real> Projected<E> {
    /// Runs `f` over all tiles in parallel; the results are in row-major order of the tiles.
    pub fn map_tiles<R: Send>(&self, f: impl Fn(&TilePairs<'_, E>) -> R + Sync) -> Vec<R> {
        let columns = self.tiles.columns;
        (0..columns * self.tiles.rows)
            .into_par_iter()
            .map(|tile| {
                let (x, y) = (tile % columns, tile / columns);
                let ranks = &self.tiles.ranks[self.tiles.tile(x, y)];
                let origin = [x * TILE, y * TILE];
                let pairs = Pairs::gather(self, Tile { origin, ranks }, fresh_transmittance(origin, self.size()));
                f(&TilePairs { origin, ids: &self.ids, ranks, pairs })
            })
            .collect()
    }
}
