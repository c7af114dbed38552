//! The contributing pairs of a view, tile by tile, for linear reads of the image other than pixel by pixel.

use super::footprint::{TILE, fresh_transmittance};
use super::pairs::Pairs;
use super::projected::Projected;
use super::settings::PairCounts;
use super::tile_loop::Tile;
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
                let tile = Tile { origin: [x * TILE, y * TILE], ranks: &self.tiles.ranks[self.tiles.tile(x, y)] };
                let pairs = Pairs::gather(self, tile, fresh_transmittance(tile, self.size()));
                f(&TilePairs { origin: tile.origin, ids: &self.ids, ranks: tile.ranks, pairs })
            })
            .collect()
    }

    /// Evaluated and contributing pairs.
    pub fn count_pairs(&self) -> PairCounts {
        let counts = self.map_tiles(|tile| tile.pairs.counts);
        counts.iter().fold(PairCounts::default(), |a, b| PairCounts {
            evaluated: a.evaluated + b.evaluated,
            contributing: a.contributing + b.contributing,
        })
    }
}
