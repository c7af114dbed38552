//! The loops over tiles, and over the Gaussians of a tile, that all kernels share.

use super::footprint::{Buffer, Corner, Footprint, Grid, TILE, Tile, live_strips};
use super::projected::{Blended, Projected};
use crate::backend::Real;
use crate::backend::simd::{Lanes, prefetch};
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// List entries between two checks of which rows are still live.
pub(super) const LIVE_CHECK_INTERVAL: usize = 16;
/// Bytes of per-entry sums held at once. They are few, so that they stay in the cache. There are never more than [`BANDS`] bands,
/// because each band looks at all Gaussians.
const BAND_BYTES: RangeInclusive<usize> = 4 << 20..=64 << 20;
const BANDS: usize = 8;

impl<E: Real> Projected<E> {
    /// The tiles of these rows of tiles, row-major.
    pub(super) fn tiles_of_rows(&self, rows: Range<usize>) -> impl Iterator<Item = Tile<'_>> {
        let tile = move |x: usize, y: usize| Tile {
            origin: [x * TILE, y * TILE],
            ranks: &self.tiles.ranks[self.tiles.tile(x, y)],
        };
        rows.flat_map(move |y| (0..self.tiles.columns).map(move |x| tile(x, y)))
    }
}

/// Runs `f` over all tiles in parallel, each with its part of the image and transmittance rows of its row of tiles.
pub(super) fn for_each_tile_row<E: Real>(
    p: &Projected<E>,
    channels: usize,
    f: impl Fn(Tile<'_>, &mut [E], &mut [E]) + Sync,
) -> Blended<E> {
    let [w, h] = p.size();
    let mut out = Blended {
        image: vec![E::zero(); w * h * channels],
        transmittance: vec![E::zero(); w * h],
    };
    let mut image = out.image.as_mut_slice();
    let mut parts = Vec::with_capacity(p.tiles.rows);
    for (row, transmittance) in out.transmittance.chunks_mut(w * TILE).enumerate() {
        let (own, rest) = image.split_at_mut(transmittance.len() * channels);
        parts.push((row, own, transmittance));
        image = rest;
    }
    parts
        .into_par_iter()
        .with_max_len(1)
        .for_each(|(row, image, transmittance)| {
            for tile in p.tiles_of_rows(row..row + 1) {
                f(tile, image, transmittance);
            }
        });
    out
}

/// Runs `f` over all tiles in parallel. `f` writes `width` sums for each list entry of its tile. Returns the sums per rank,
/// `[visible, width]`, added up in an order that does not depend on the number of threads.
pub(super) fn sum_over_tiles<E: Real>(
    p: &Projected<E>,
    width: usize,
    f: impl Fn(Tile<'_>, &mut [E]) + Sync,
) -> Vec<E> {
    let mut sums = vec![E::zero(); p.splats.len() * width];
    if width == 0 {
        return sums;
    }
    let mut cursors = vec![0_u32; p.splats.len()];
    let entry = width * size_of::<E>();
    let limit = (p.tiles.ranks.len() * entry / BANDS).clamp(*BAND_BYTES.start(), *BAND_BYTES.end());
    let mut partial = Vec::new();
    let mut row = 0;
    while row < p.tiles.rows {
        // As many rows of tiles as fit, at least one.
        let mut end = row + 1;
        while end < p.tiles.rows && p.tiles.tile_rows(row..end + 1).len() * entry <= limit {
            end += 1;
        }
        let band = p.tiles.tile_rows(row..end);
        partial.clear();
        partial.resize(band.len() * width, E::zero());
        let mut rest = partial.as_mut_slice();
        let mut parts = Vec::with_capacity((end - row) * p.tiles.columns);
        for tile in p.tiles_of_rows(row..end) {
            let own = rest
                .split_off_mut(..tile.ranks.len() * width)
                .unwrap_or_default();
            if !own.is_empty() {
                parts.push((tile, own));
            }
        }
        parts.into_par_iter().for_each(|(tile, own)| f(tile, own));
        sums.par_chunks_mut(width * 256)
            .zip(cursors.par_chunks_mut(256))
            .enumerate()
            .for_each(|(chunk, (sums, cursors))| {
                let own = sums.chunks_exact_mut(width).zip(cursors);
                for ((sum, cursor), rank) in own.zip(chunk * 256..) {
                    let slots = &p.tiles.slots(rank)[*cursor as usize..];
                    for &slot in slots.iter().take_while(|slot| (**slot as usize) < band.end) {
                        *cursor += 1;
                        let part = &partial[(slot as usize - band.start) * width..][..width];
                        for (s, &x) in sum.iter_mut().zip(part) {
                            *s += x;
                        }
                    }
                }
            });
        row = end;
    }
    sums
}

/// What a kernel does with the Gaussians of a tile, front to back.
pub(super) trait Pass<E> {
    /// Transmittance of the tile's pixels, negative where a pixel has ended.
    fn transmittance(&self) -> &Buffer<E>;
    /// The next Gaussians have these ranks, [`LIVE_CHECK_INTERVAL`] at most. Passes that read nothing of them do nothing.
    #[inline(always)]
    fn gather(&mut self, _ranks: &[u32]) {}
    /// Takes the `next`-th of them, which is entry `entry` of the tile's list.
    fn take(&mut self, next: usize, entry: usize, footprint: &Footprint<E>);
}

/// Shows `pass` the Gaussians of `tile` until all pixels have ended.
#[inline(always)]
pub(super) fn walk<E: Real, S: Lanes<E>>(
    s: S,
    p: &Projected<E>,
    tile: Tile<'_>,
    pass: &mut impl Pass<E>,
) {
    let grid = Grid::new(s);
    let mut footprint = Footprint::empty();
    let mut corners = [Corner::default(); LIVE_CHECK_INTERVAL];
    for (look, ranks) in tile.ranks.chunks(LIVE_CHECK_INTERVAL).enumerate() {
        for &rank in tile
            .ranks
            .iter()
            .skip((look + 1) * LIVE_CHECK_INTERVAL)
            .take(LIVE_CHECK_INTERVAL)
        {
            prefetch(&p.splats[rank as usize]);
        }
        let live = live_strips(s, pass.transmittance());
        if live == 0 {
            break;
        }
        // All reads of far memory come first, so that they wait for each other as little as possible.
        for (corner, &rank) in corners.iter_mut().zip(ranks) {
            *corner = Corner::new(&p.splats[rank as usize], tile);
        }
        pass.gather(ranks);
        for (next, corner) in corners[..ranks.len()].iter().enumerate() {
            footprint.place(s, corner, &grid);
            footprint.strips &= live;
            pass.take(next, look * LIVE_CHECK_INTERVAL + next, &footprint);
        }
    }
}

/// Rows of `values`, `[visible, C]`, of these ranks.
#[inline(always)]
pub(super) fn gather_rows<E: Copy, const C: usize>(
    values: &[E],
    ranks: &[u32],
    out: &mut [[E; C]; LIVE_CHECK_INTERVAL],
) {
    for (out, &rank) in out.iter_mut().zip(ranks) {
        out.copy_from_slice(&values[rank as usize * C..][..C]);
    }
}
