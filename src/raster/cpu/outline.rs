//! The ellipses of projected Gaussians: the pixel rows and, in a row of tiles, the columns that they cover.
//!
//! Nothing is fused, so that the lists do not depend on the instruction set.

use super::footprint::{Splat2, TILE};
use crate::backend::simd::vectorized;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Gaussians of one loop.
const BLOCK: usize = 32;
/// Entries of the tile lists of a view, at most: each takes 16 bytes while lists are made.
pub(super) const MAX_ENTRIES: usize = 1 << 28;
/// A value of each.
type Column = [f64; BLOCK];

/// The tiles of neighbouring ranks.
#[derive(Debug, Default)]
pub(super) struct Bins {
    /// Numbers of the tiles of every rank, one rank after the other: rows of tiles in order, left to right.
    pub tiles: Vec<u32>,
    /// How many each rank has.
    pub counts: Vec<u32>,
    /// Entries per tile.
    pub per_tile: Vec<u32>,
}

/// Finds every tile of an image of `size` pixels that holds a pixel centre near the ellipse of each of `splats`.
/// Stops early, with [`Bins::counts`] of fewer ranks, once `total` of all calls exceeds [`MAX_ENTRIES`].
pub(super) fn bin(splats: &[Splat2], size: [usize; 2], total: &AtomicUsize) -> Bins {
    vectorized(
        #[inline(always)]
        || bin_all(splats, size, total),
    )
}

#[inline(always)]
fn bin_all(splats: &[Splat2], size: [usize; 2], total: &AtomicUsize) -> Bins {
    let [across, down] = size.map(|s| s.div_ceil(TILE));
    let mut bins = Bins {
        tiles: Vec::with_capacity(4 * splats.len()),
        counts: Vec::with_capacity(splats.len()),
        per_tile: vec![0; across * down],
    };
    for splats in splats.chunks(BLOCK) {
        let entries = bins.tiles.len();
        let outlines = Outlines::new(splats);
        let mut rows = [const { 0..0 }; BLOCK];
        for (l, rows) in rows.iter_mut().enumerate() {
            *rows = outlines.pixel_rows(l, size[1]);
        }
        // Most ellipses meet two rows of tiles at most.
        let edges = [outlines.all_edges(&rows, 0), outlines.all_edges(&rows, 1)];
        for (l, rows) in rows.iter().enumerate().take(splats.len()) {
            let before = bins.tiles.len();
            let first = rows.start / TILE;
            let reached = if rows.is_empty() {
                0
            } else {
                rows.end.div_ceil(TILE) - first
            };
            for k in 0..reached {
                let [left, right] = match edges.get(k) {
                    Some(edges) => [edges[0][l], edges[1][l]],
                    None => outlines.edges(l, tile_row(rows, k)),
                };
                let columns = between(left, right, size[0]);
                if !columns.is_empty() {
                    let row = (first + k) * across;
                    for tile in row + columns.start / TILE..row + columns.end.div_ceil(TILE) {
                        bins.tiles.push(tile as u32);
                        bins.per_tile[tile] += 1;
                    }
                }
            }
            bins.counts.push((bins.tiles.len() - before) as u32);
        }
        let new = bins.tiles.len() - entries;
        if total.fetch_add(new, Ordering::Relaxed) + new > MAX_ENTRIES {
            break;
        }
    }
    bins
}

/// The first pixel row, and one past the last, that `rows` have in the `k`-th row of tiles that they meet.
#[inline(always)]
fn tile_row(rows: &Range<usize>, k: usize) -> [f64; 2] {
    let top = (rows.start / TILE + k) * TILE;
    [rows.start.max(top) as f64, rows.end.min(top + TILE) as f64]
}

/// What tile lists need of ellipses.
struct Outlines {
    center: [Column; 2],
    slope: Column,
    /// Half axes of the row section and of the bounding box.
    half: [Column; 2],
    /// `1 / half[1]`.
    per_half: Column,
    /// Variant offset at which the ellipse is furthest right.
    right_at: Column,
}

impl Outlines {
    /// Outlines of `splats`, [`BLOCK`] at most.
    #[inline(always)]
    fn new(splats: &[Splat2]) -> Self {
        let none = [0.0; BLOCK];
        let mut center = [none; 2];
        let mut slope = none;
        // Lanes beyond the last splat need values that divide well; nobody reads their results.
        let mut du = [1.0; BLOCK];
        let mut dv = [1.0; BLOCK];
        let mut reach = [1.0; BLOCK];
        for (l, s) in splats.iter().enumerate() {
            (center[0][l], center[1][l], slope[l]) = (s.center[0], s.center[1], s.slope);
            (du[l], dv[l], reach[l]) = (s.du, s.dv, s.reach);
        }
        let mut out = Self {
            center,
            slope,
            half: [none; 2],
            per_half: none,
            right_at: none,
        };
        for l in 0..BLOCK {
            let (sx, sy) = (1.0 / du[l], 1.0 / dv[l]);
            let wide = (sx * sx + slope[l] * slope[l] * sy * sy).sqrt();
            out.half[0][l] = reach[l] * sx;
            out.half[1][l] = reach[l] * sy;
            out.per_half[l] = 1.0 / out.half[1][l];
            out.right_at[l] = reach[l] * slope[l] * sy * sy / wide;
        }
        out
    }

    /// Pixel rows whose centres the `l`-th covers.
    #[inline(always)]
    fn pixel_rows(&self, l: usize, height: usize) -> Range<usize> {
        between(
            self.center[1][l] - self.half[1][l],
            self.center[1][l] + self.half[1][l],
            height,
        )
    }

    /// [`Outlines::edges`] of all in the `k`-th rows of tiles that they meet.
    #[inline(always)]
    fn all_edges(&self, rows: &[Range<usize>; BLOCK], k: usize) -> [Column; 2] {
        let (mut start, mut end, mut left, mut right) =
            ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for (l, rows) in rows.iter().enumerate() {
            [start[l], end[l]] = tile_row(rows, k);
        }
        for l in 0..BLOCK {
            [left[l], right[l]] = self.edges(l, [start[l], end[l]]);
        }
        [left, right]
    }

    /// How far the `l`-th reaches to the left and right in pixel rows `start..end`.
    #[inline(always)]
    fn edges(&self, l: usize, [start, end]: [f64; 2]) -> [f64; 2] {
        let x = self.center[0][l];
        let y = self.center[1][l];
        let half_y = self.half[1][l];
        let low = (start + 0.5 - y).max(-half_y);
        let high = (end - 0.5 - y).min(half_y);
        let half = |dy: f64| {
            let share = dy * self.per_half[l];
            self.half[0][l] * (1.0 - share * share).max(0.0).sqrt()
        };
        // The right edge is concave in dy with its top at `right_at`; the left edge is its mirror image.
        let right = self.right_at[l].max(low).min(high);
        let left = (-self.right_at[l]).max(low).min(high);
        [
            x + self.slope[l] * left - half(left),
            x + self.slope[l] * right + half(right),
        ]
    }
}

/// Pixels whose centres lie within `low..=high`, of `limit`.
#[inline(always)]
fn between(low: f64, high: f64, limit: usize) -> Range<usize> {
    // Rounded by casts, which saturate: `ceil` and `floor` are calls on baseline x86-64.
    let low = (low - 0.5).clamp(0.0, limit as f64);
    let first = low as usize + usize::from((low as usize as f64) < low);
    let end = if high >= 0.5 {
        ((high - 0.5).min(limit as f64) as usize + 1).min(limit)
    } else {
        0
    };
    first..end.max(first)
}

#[cfg(test)]
mod tests {
    use super::{Splat2, bin, bin_all};
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn wide_instructions_list_the_same_tiles() {
        let splat = |i: usize| {
            let wave = |seed: f64| (1.7 * i as f64 + seed).sin();
            Splat2 {
                center: [150.0 * wave(0.1), 110.0 * wave(2.3)],
                slope: 2.0 * wave(0.7),
                du: (2.0 * wave(1.1) - 3.0).exp2(),
                dv: (2.0 * wave(1.9) - 3.0).exp2(),
                // Some reach every pixel.
                reach: if i.is_multiple_of(97) {
                    1e6
                } else {
                    1.0 + i as f64 % 7.0 / 3.0
                },
                log_opacity: 0.0,
            }
        };
        let splats: Vec<Splat2> = (0..3_000).map(splat).collect();
        let total = AtomicUsize::new(0);
        let wide = bin(&splats, [131, 97], &total);
        let plain = bin_all(&splats, [131, 97], &total);
        assert_eq!(
            (wide.tiles, wide.counts, wide.per_tile),
            (plain.tiles.clone(), plain.counts, plain.per_tile)
        );
        assert!(plain.tiles.len() > 3_000, "{}", plain.tiles.len());
    }
}
