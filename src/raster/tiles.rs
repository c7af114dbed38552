//! Depth order and tile lists.

use super::footprint::{Splat2, TILE};
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// Gaussians that one task bins.
const CHUNK: usize = 4096;

/// Ranks of Gaussians (positions in depth order) per tile, front to back.
#[derive(Clone, Debug, Default)]
pub(super) struct TileLists {
    /// Tiles across and down.
    pub columns: usize,
    pub rows: usize,
    /// Start of each tile's list in `ranks`, row-major, and the end of the last.
    starts: Vec<u32>,
    pub ranks: Vec<u32>,
    /// Start of each rank's run in `slots`, and the end of the last.
    runs: Vec<u32>,
    /// For each rank its positions in `ranks`, ascending.
    slots: Vec<u32>,
}

impl TileLists {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        [&self.starts, &self.ranks, &self.runs, &self.slots].into_iter().map(|list| size_of_val(&**list)).sum()
    }

    /// Positions in [`TileLists::ranks`] of the tile in column `x`, row `y`.
    pub fn tile(&self, x: usize, y: usize) -> Range<usize> {
        let tile = y * self.columns + x;
        self.starts[tile] as usize..self.starts[tile + 1] as usize
    }

    /// Positions in [`TileLists::ranks`] of whole rows of tiles.
    pub fn tile_rows(&self, rows: Range<usize>) -> Range<usize> {
        self.starts[rows.start * self.columns] as usize..self.starts[rows.end * self.columns] as usize
    }

    /// Positions in [`TileLists::ranks`] at which `rank` stands, ascending.
    pub fn slots(&self, rank: usize) -> &[u32] {
        &self.slots[self.runs[rank] as usize..self.runs[rank + 1] as usize]
    }
}

/// Indices of `depths` (positive, finite) in ascending order, ties by index.
pub(super) fn depth_order(depths: &[f64]) -> Vec<u32> {
    // Radix sort by the bits of the depth rounded to f32, which ascend with it, then put right what rounding made equal.
    let mut keys: Vec<(u32, u32)> = depths.iter().zip(0..).map(|(&z, i)| ((z as f32).to_bits(), i)).collect();
    let mut other = keys.clone();
    for shift in [0, 11, 22] {
        let digit = |key: u32| (key >> shift & 0x7ff) as usize;
        let mut starts = [0_u32; 2048];
        for &(key, _) in &keys {
            starts[digit(key)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &entry in &keys {
            let at = &mut starts[digit(entry.0)];
            other[*at as usize] = entry;
            *at += 1;
        }
        std::mem::swap(&mut keys, &mut other);
    }
    for run in keys.chunk_by_mut(|a, b| a.0 == b.0) {
        if run.len() > 1 {
            run.sort_unstable_by(|a, b| depths[a.1 as usize].total_cmp(&depths[b.1 as usize]).then(a.1.cmp(&b.1)));
        }
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

/// The ellipse of a Gaussian as far as tile lists need it.
struct Outline {
    center: [f64; 2],
    slope: f64,
    /// Half axes of the row section and of the bounding box.
    half: [f64; 2],
    reach: f64,
    /// Row offset at which the ellipse is furthest right.
    right_at: f64,
}

impl Outline {
    fn new(s: &Splat2) -> Self {
        let (sx, sy) = (s.du.recip(), s.dv.recip());
        let wide = (sx * sx + s.slope * s.slope * sy * sy).sqrt();
        let right_at = if s.reach.is_finite() { s.reach * s.slope * sy * sy / wide } else { 0.0 };
        Self { center: s.center, slope: s.slope, half: [s.reach * sx, s.reach * sy], reach: s.reach, right_at }
    }

    /// Pixel rows whose centres the ellipse covers.
    fn pixel_rows(&self, height: usize) -> Range<usize> {
        between(self.center[1] - self.half[1], self.center[1] + self.half[1], height)
    }

    /// Pixel columns whose centres the ellipse covers somewhere in pixel rows `rows`.
    fn pixel_columns(&self, rows: Range<usize>, width: usize) -> Range<usize> {
        if !self.reach.is_finite() {
            return 0..width;
        }
        let low = (rows.start as f64 + 0.5 - self.center[1]).max(-self.half[1]);
        let high = (rows.end as f64 - 0.5 - self.center[1]).min(self.half[1]);
        let half = |dy: f64| self.half[0] * (1.0 - (dy / self.half[1]).powi(2)).max(0.0).sqrt();
        // The right edge is concave in dy with its top at `right_at`; the left edge is its mirror image.
        let right = self.right_at.max(low).min(high);
        let left = (-self.right_at).max(low).min(high);
        between(
            self.center[0] + self.slope * left - half(left),
            self.center[0] + self.slope * right + half(right),
            width,
        )
    }

    /// Calls `f` with every tile that holds a pixel centre near the ellipse: rows of tiles in order, left to right.
    fn tiles(&self, size: [usize; 2], mut f: impl FnMut(usize, Range<usize>)) {
        let pixels = self.pixel_rows(size[1]);
        if pixels.is_empty() {
            return;
        }
        for row in pixels.start / TILE..pixels.end.div_ceil(TILE) {
            let rows = pixels.start.max(row * TILE)..pixels.end.min((row + 1) * TILE);
            let columns = self.pixel_columns(rows, size[0]);
            if !columns.is_empty() {
                f(row, columns.start / TILE..columns.end.div_ceil(TILE));
            }
        }
    }
}

/// Pixels whose centres lie within `low..=high`, of `limit`.
#[inline(always)]
pub(super) fn between(low: f64, high: f64, limit: usize) -> Range<usize> {
    // Rounded by casts, which saturate: `ceil` and `floor` are calls on baseline x86-64.
    let low = (low - 0.5).clamp(0.0, limit as f64);
    let first = low as usize + usize::from((low as usize as f64) < low);
    let end = if high >= 0.5 { ((high - 0.5).min(limit as f64) as usize + 1).min(limit) } else { 0 };
    first..end.max(first)
}

/// Lists for `splats` in depth order over an image of `size` pixels.
///
/// # Errors
/// [`Error::Limit`] when the lists would have more than 2^32 - 1 entries.
pub(super) fn tile_lists(splats: &[Splat2], size: [usize; 2]) -> Result<TileLists> {
    let [columns, rows] = size.map(|s| s.div_ceil(TILE));
    let tiles = columns * rows;
    struct Chunk {
        /// Tiles of every rank, one after the other, and how many each rank has.
        tiles: Vec<u32>,
        counts: Vec<u32>,
        /// Entries per tile; later the next free position per tile.
        cursor: Vec<u32>,
    }
    let chunk_len = CHUNK.max(splats.len().div_ceil(64));
    let mut chunks: Vec<Chunk> = splats
        .par_chunks(chunk_len)
        .map(|splats| {
            let mut chunk =
                Chunk { tiles: Vec::with_capacity(4 * splats.len()), counts: Vec::new(), cursor: vec![0; tiles] };
            for splat in splats {
                let before = chunk.tiles.len();
                Outline::new(splat).tiles(size, |row, span| {
                    for tile in row * columns + span.start..row * columns + span.end {
                        chunk.tiles.push(tile as u32);
                        chunk.cursor[tile] += 1;
                    }
                });
                chunk.counts.push((chunk.tiles.len() - before) as u32);
            }
            chunk
        })
        .collect();
    let total: usize = chunks.iter().map(|c| c.tiles.len()).sum();
    if total > u32::MAX as usize {
        return Err(Error::Limit {
            what: "entries of the tile lists of one view".into(),
            found: total.to_string(),
            limit: u32::MAX.to_string(),
            mend: "render a smaller image, or remove very large Gaussians".into(),
        });
    }
    let mut starts = Vec::with_capacity(tiles + 1);
    let mut sum = 0;
    for tile in 0..tiles {
        starts.push(sum);
        for chunk in &mut chunks {
            sum += std::mem::replace(&mut chunk.cursor[tile], sum);
        }
    }
    starts.push(sum);
    let mut slots = vec![0_u32; total];
    let mut rest = slots.as_mut_slice();
    let mut parts = Vec::with_capacity(chunks.len());
    for chunk in &mut chunks {
        let (own, others) = rest.split_at_mut(chunk.tiles.len());
        parts.push((chunk, own));
        rest = others;
    }
    parts.into_par_iter().for_each(|(chunk, slots)| {
        for (slot, &tile) in slots.iter_mut().zip(&chunk.tiles) {
            let next = &mut chunk.cursor[tile as usize];
            *slot = *next;
            *next += 1;
        }
    });
    let mut runs = Vec::with_capacity(splats.len() + 1);
    let mut at = 0;
    for &count in chunks.iter().flat_map(|c| &c.counts) {
        runs.push(at);
        at += count;
    }
    runs.push(at);
    // Every slot is written once, by one thread: the order of the stores does not matter.
    let ranks: Vec<AtomicU32> = (0..total).into_par_iter().map(|_| AtomicU32::default()).collect();
    (0..splats.len()).into_par_iter().with_min_len(CHUNK).for_each(|rank| {
        for &slot in &slots[runs[rank] as usize..runs[rank + 1] as usize] {
            ranks[slot as usize].store(rank as u32, Ordering::Relaxed);
        }
    });
    let ranks = ranks.into_iter().map(AtomicU32::into_inner).collect();
    Ok(TileLists { columns, rows, starts, ranks, runs, slots })
}
