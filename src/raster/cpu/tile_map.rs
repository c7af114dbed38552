//! The contributing pairs of a view, tile by tile, for `segmentation::unprojection::lift_view`, which sums pixels by cells of a
//! lattice.

use super::footprint::TILE;
use super::pairs::Pairs;
use super::projected::Projected;
use super::tiles::TileLists;
use crate::backend::Real;
use crate::data::mask::Mask;
use rayon::prelude::*;

/// Contributing pairs of one tile, Gaussian by Gaussian, front to back.
pub struct TilePairs<E> {
    /// Column and row of the tile's first pixel.
    pub origin: [usize; 2],
    pairs: Pairs<E, false>,
}

impl<E: Real> TilePairs<E> {
    /// Pixels along a tile's edge.
    pub const EDGE: usize = TILE;

    /// Gaussians of the tile that were visited before all its pixels ended.
    pub fn len(&self) -> usize {
        self.pairs.ends.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The pixels that the `i`-th Gaussian contributes to (`row * EDGE + column` within the tile, ascending by row) and its weights
    /// alpha' T there.
    pub fn gaussian(&self, i: usize) -> (&[u16], &[E]) {
        let Pairs {
            pixels, weights, ..
        } = &self.pairs;
        let range = self.pairs.range(i);
        (&pixels[range.clone()], &weights[range])
    }
}

impl<E: Real> Projected<E> {
    /// Runs `f` over all tiles in parallel, with the tile's number (row-major), its pairs of the pixels that `mask` uses, and
    /// its part of `entries`. `entries` has [`Projected::tile_entries`] elements: one for each Gaussian of each tile, in order,
    /// including those behind [`TilePairs::len`]. Results are in the order of the tiles.
    ///
    /// # Panics
    /// If `entries` has another length.
    pub fn map_tiles<T: Send, R: Send>(
        &self,
        mask: Option<&Mask>,
        entries: &mut [T],
        f: impl Fn(usize, &TilePairs<E>, &mut [T]) -> R + Sync,
    ) -> Vec<R> {
        assert_eq!(
            entries.len(),
            self.tiles.ranks.len(),
            "map_tiles: entries against tile lists"
        );
        let mut rest = entries;
        let mut parts = Vec::with_capacity(self.tiles.columns * self.tiles.rows);
        for tile in self.tiles_of_rows(0..self.tiles.rows) {
            let own = rest.split_off_mut(..tile.ranks.len());
            parts.push((tile, own.unwrap_or_default()));
        }
        parts
            .into_par_iter()
            .enumerate()
            .map(|(number, (tile, own))| {
                let used = |pixel| mask.is_none_or(|mask| mask.uses(pixel));
                let pairs = TilePairs {
                    origin: tile.origin,
                    pairs: Pairs::gather(self, tile, used),
                };
                f(number, &pairs, own)
            })
            .collect()
    }

    /// The entries of each Gaussian in the tile lists.
    pub fn positions(&self) -> Positions<'_> {
        Positions {
            ranks: self.ranks(),
            tiles: &self.tiles,
        }
    }
}

/// The entries of Gaussians in the tile lists.
pub struct Positions<'a> {
    /// Position in depth order of each Gaussian of the scene; culled ones have `u32::MAX`.
    ranks: Vec<u32>,
    tiles: &'a TileLists,
}

impl Positions<'_> {
    /// Positions of Gaussian `i` among the entries of [`Projected::map_tiles`], ascending; none for a culled one.
    #[inline(always)]
    pub fn of(&self, i: usize) -> &[u32] {
        match self.ranks[i] {
            u32::MAX => &[],
            rank => self.tiles.slots(rank as usize),
        }
    }
}
