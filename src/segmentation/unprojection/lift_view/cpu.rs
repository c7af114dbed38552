//! Lifting on the CPU.
//!
//! First, each tile computes scalar weights per (Gaussian, feature cell): blending weights times bilinear taps. Then every
//! Gaussian gathers the feature vectors of its cells, each once. Threads own disjoint Gaussians, which take their tiles in order.

use super::Sums;
use super::cell_weights::{CellWeight, Entry, Taps, tile_cell_weights};
use crate::backend::Real;
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::data::mask::Mask;
use crate::error::Result;
use crate::features::{FeatureMap, Lattice};
use crate::raster::{Positions, Projected, Settings, Splats};
use crate::splat::camera::Camera;
use rayon::prelude::*;

/// Gaussians that one task gathers for.
const CHUNK: usize = 512;
/// Channels summed in registers.
const LANES: usize = 64;

/// Adds the view of `camera`, of the pixels that `mask` uses; `grids` lists the lattices of the maps and the scales that have them.
pub(super) fn lift_view<E: Real>(
    sums: &mut Sums<E>,
    splats: &Splats<'_, E>,
    camera: &Camera,
    maps: &[FeatureMap],
    mask: Option<&Mask>,
    grids: &[(Lattice, Vec<usize>)],
    settings: &Settings,
) -> Result<()> {
    let projected = Projected::new(splats, camera, settings)?;
    let view = ViewWeights::new(&projected, camera, mask, grids);
    let counts = projected.used_counts(mask);
    let pixels = mask.map_or(camera.width * camera.height, Mask::kept);
    // For each chunk of Gaussians its rows at every scale.
    let mut chunks: Vec<Vec<Rows<'_, E>>> = (0..splats.len().div_ceil(CHUNK))
        .map(|_| Vec::with_capacity(maps.len()))
        .collect();
    for (scale, ((buffer, weights), map)) in sums
        .buffers
        .iter_mut()
        .zip(&mut sums.weights)
        .zip(maps)
        .enumerate()
    {
        let Some(grid) = grids.iter().position(|(_, scales)| scales.contains(&scale)) else {
            continue;
        };
        sums.pixels[scale] += pixels as u64;
        for (sum, &count) in sums.counts[scale].iter_mut().zip(&counts) {
            *sum += u64::from(count);
        }
        let mut rest = buffer.as_mut_slice();
        for (chunk, weights) in chunks.iter_mut().zip(weights.chunks_mut(CHUNK)) {
            let (buffer, others) = rest.split_at_mut(weights.len() * map.channels);
            rest = others;
            chunk.push(Rows {
                buffer,
                weights,
                map,
                grid,
            });
        }
    }
    chunks
        .par_iter_mut()
        .enumerate()
        .for_each(|(chunk, scales)| gather(scales, chunk * CHUNK, &view));
    Ok(())
}

/// The cell weights of a view.
struct ViewWeights<'a, E> {
    tiles: Vec<Vec<CellWeight<E>>>,
    /// One for each Gaussian of each tile, in the order of the tile lists.
    entries: Vec<Entry<E>>,
    positions: Positions<'a>,
}

impl<'a, E: Real> ViewWeights<'a, E> {
    fn new(
        projected: &'a Projected<E>,
        camera: &Camera,
        mask: Option<&Mask>,
        grids: &[(Lattice, Vec<usize>)],
    ) -> Self {
        let lattices = grids.iter().map(|(lattice, _)| lattice);
        let taps: Vec<Taps> = lattices.map(|lattice| Taps::new(lattice, camera)).collect();
        let mut entries = vec![Entry::default(); projected.tile_entries()];
        let tiles = projected.map_tiles(mask, &mut entries, |tile, pairs, own| {
            tile_cell_weights(tile, pairs, &taps, own)
        });
        Self {
            tiles,
            entries,
            positions: projected.positions(),
        }
    }
}

/// What neighbouring Gaussians gather at one scale.
struct Rows<'a, E> {
    /// `[Gaussians, channels]`.
    buffer: &'a mut [E],
    /// `[Gaussians]`.
    weights: &'a mut [E],
    map: &'a FeatureMap,
    /// Number of the map's grid.
    grid: usize,
}

wide_kernel! {
    /// `row += sum of weight * map[cell]` at every scale, for the Gaussians from `first` on.
    fn gather(scales: &mut [Rows<'_, E>], first: usize, view: &ViewWeights<'_, E>) => gather_rows
}

#[inline(always)]
fn gather_rows<E: Real, const FMA: bool>(
    scales: &mut [Rows<'_, E>],
    first: usize,
    view: &ViewWeights<'_, E>,
) {
    // All entries first: scattered reads that do not wait for each other.
    let mut near = Vec::new();
    let mut ends = Vec::new();
    for i in (first..).take(scales.first().map_or(0, |rows| rows.weights.len())) {
        near.extend(
            view.positions
                .of(i)
                .iter()
                .map(|&at| view.entries[at as usize]),
        );
        ends.push(near.len());
    }
    near.iter()
        .for_each(|entry: &Entry<E>| entry.prefetch(&view.tiles));
    let mut start = 0;
    for (i, end) in ends.into_iter().enumerate() {
        let entries = &near[start..end];
        start = end;
        if entries.is_empty() {
            continue;
        }
        let weight: E = entries.iter().map(|entry| entry.weight).sum();
        for rows in scales.iter_mut() {
            rows.weights[i] += weight;
            add_cells::<E, FMA>(rows, i, entries, &view.tiles);
        }
    }
}

/// Adds the weighted cells of `entries`, those of the `i`-th Gaussian, to its row.
#[inline(always)]
fn add_cells<E: Real, const FMA: bool>(
    rows: &mut Rows<'_, E>,
    i: usize,
    entries: &[Entry<E>],
    tiles: &[Vec<CellWeight<E>>],
) {
    let Rows { map, grid, .. } = *rows;
    let channels = map.channels;
    let row = &mut rows.buffer[i * channels..(i + 1) * channels];
    let (blocks, rest) = row.as_chunks_mut::<LANES>();
    let rest_at = blocks.len() * LANES;
    for (block, out) in blocks.iter_mut().enumerate() {
        let mut sum = [E::zero(); LANES];
        for entry in entries {
            for &CellWeight { cell, weight } in entry.cells(tiles, grid) {
                let from = &map.data[cell as usize * channels + block * LANES..];
                let Some(from) = from.first_chunk::<LANES>() else {
                    continue;
                };
                for l in 0..LANES {
                    sum[l] = multiply_add::<E, FMA>(weight, E::of(f64::from(from[l])), sum[l]);
                }
            }
        }
        for l in 0..LANES {
            out[l] += sum[l];
        }
    }
    if rest.is_empty() {
        return;
    }
    let mut sum = [E::zero(); LANES];
    for entry in entries {
        for &CellWeight { cell, weight } in entry.cells(tiles, grid) {
            let from = &map.data[cell as usize * channels + rest_at..][..rest.len()];
            for (s, &x) in sum.iter_mut().zip(from) {
                *s = multiply_add::<E, FMA>(weight, E::of(f64::from(x)), *s);
            }
        }
    }
    for (o, s) in rest.iter_mut().zip(sum) {
        *o += s;
    }
}
