//! Depth order and tile lists.

use super::footprint::{Splat2, TILE};
use super::outline::{Bins, MAX_ENTRIES, bin};
use crate::error::{Result, ensure};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

/// Gaussians that one task bins.
const CHUNK: usize = 4096;

/// Ranks of Gaussians (positions in depth order) per tile, front to back.
#[derive(Clone, Debug, Default)]
pub(in crate::raster) struct TileLists {
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
    /// Positions in [`TileLists::ranks`] of the tile in column `x`, row `y`.
    pub fn tile(&self, x: usize, y: usize) -> Range<usize> {
        let tile = y * self.columns + x;
        self.starts[tile] as usize..self.starts[tile + 1] as usize
    }

    /// Positions in [`TileLists::ranks`] of whole rows of tiles.
    pub fn tile_rows(&self, rows: Range<usize>) -> Range<usize> {
        self.starts[rows.start * self.columns] as usize
            ..self.starts[rows.end * self.columns] as usize
    }

    /// Positions in [`TileLists::ranks`] at which `rank` stands, ascending.
    pub fn slots(&self, rank: usize) -> &[u32] {
        &self.slots[self.runs[rank] as usize..self.runs[rank + 1] as usize]
    }
}

/// Indices of `depths` (positive, finite) in ascending order, ties by index.
pub(in crate::raster) fn depth_order(depths: &[f64]) -> Vec<u32> {
    // Radix sort by the bits of the depth rounded to f32, which ascend with it, then put right what rounding made equal.
    let mut keys: Vec<(u32, u32)> = depths
        .iter()
        .zip(0..)
        .map(|(&z, i)| ((z as f32).to_bits(), i))
        .collect();
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
            run.sort_unstable_by(|a, b| {
                depths[a.1 as usize]
                    .total_cmp(&depths[b.1 as usize])
                    .then(a.1.cmp(&b.1))
            });
        }
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

/// Lists for `splats` in depth order over an image of `size` pixels.
///
/// # Errors
/// [`crate::Error::Limit`] when the lists would have more than [`MAX_ENTRIES`] entries.
pub(in crate::raster) fn tile_lists(splats: &[Splat2], size: [usize; 2]) -> Result<TileLists> {
    let [columns, rows] = size.map(|s| s.div_ceil(TILE));
    let tiles = columns * rows;
    let chunk_len = CHUNK.max(splats.len().div_ceil(64));
    // `per_tile` becomes the next free position of each tile.
    let listed = AtomicUsize::new(0);
    let mut chunks: Vec<Bins> = splats
        .par_chunks(chunk_len)
        .map(|splats| bin(splats, size, &listed))
        .collect();
    let total: usize = chunks.iter().map(|c| c.tiles.len()).sum();
    let done: usize = chunks.iter().map(|c| c.counts.len()).sum();
    ensure!(total <= MAX_ENTRIES,
        limit "entries of the tile lists of one view, 16 bytes each";
        found "{total} of the first {done} of {} visible Gaussians", splats.len(); expected "{MAX_ENTRIES}";
        help "render a smaller image, or remove very large Gaussians");
    let mut starts = Vec::with_capacity(tiles + 1);
    let mut sum = 0;
    for tile in 0..tiles {
        starts.push(sum);
        for chunk in &mut chunks {
            sum += std::mem::replace(&mut chunk.per_tile[tile], sum);
        }
    }
    starts.push(sum);
    let mut slots = vec![0_u32; total];
    // Every one is written once, by one thread: the order of the stores does not matter.
    let ranks: Vec<AtomicU32> = (0..total)
        .into_par_iter()
        .map(|_| AtomicU32::default())
        .collect();
    let mut rest = slots.as_mut_slice();
    let mut parts = Vec::with_capacity(chunks.len());
    for chunk in &mut chunks {
        let (own, others) = rest.split_at_mut(chunk.tiles.len());
        parts.push((chunk, own));
        rest = others;
    }
    parts
        .into_par_iter()
        .enumerate()
        .for_each(|(number, (chunk, slots))| {
            let mut entries = slots.iter_mut().zip(&chunk.tiles);
            for (&count, rank) in chunk.counts.iter().zip((number * chunk_len) as u32..) {
                for (slot, &tile) in entries.by_ref().take(count as usize) {
                    let next = &mut chunk.per_tile[tile as usize];
                    *slot = *next;
                    ranks[*next as usize].store(rank, Ordering::Relaxed);
                    *next += 1;
                }
            }
        });
    let mut runs = Vec::with_capacity(splats.len() + 1);
    let mut at = 0;
    for &count in chunks.iter().flat_map(|c| &c.counts) {
        runs.push(at);
        at += count;
    }
    runs.push(at);
    let ranks = ranks.into_iter().map(AtomicU32::into_inner).collect();
    Ok(TileLists {
        columns,
        rows,
        starts,
        ranks,
        runs,
        slots,
    })
}
