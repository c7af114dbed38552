//! One view's part of the unprojection.
//!
//! First the pairs of each tile are folded to scalar weights per (Gaussian, feature cell) through the bilinear taps; then
//! every Gaussian gathers its cells' feature vectors, each once. Threads own disjoint Gaussians, which take their tiles in
//! order.

use super::Sums;
use super::fold::{Taps, TileSums, fold_tile};
use crate::camera::Camera;
use crate::error::Result;
use crate::features::{FeatureMap, Lattice};
use crate::ops::Real;
use crate::ops::simd::{multiply_add, wide_kernel};
use crate::raster::{Projected, Settings, Splats};
use rayon::prelude::*;

/// Gaussians that one task gathers for.
const CHUNK: usize = 512;
/// Channels summed in registers.
const LANES: usize = 64;

/// Adds the view of `camera`; `grids` lists the lattices of the maps and the scales that have them.
pub fn add<E: Real>(
    sums: &mut Sums<E>,
    splats: &Splats<'_, E>,
    camera: &Camera,
    maps: &[FeatureMap],
    grids: &[(Lattice, Vec<usize>)],
    settings: &Settings,
) -> Result<()> {
    let projected = Projected::new(splats, camera, settings)?;
    let taps: Vec<Taps> = grids.iter().map(|(lattice, _)| Taps::new(lattice, camera)).collect();
    let tiles = projected.map_tiles(|pairs| fold_tile(pairs, &taps));
    let places = places(&tiles, splats.len());
    let counts = projected.counts();
    for (grid, (_, scales)) in grids.iter().enumerate() {
        for &scale in scales {
            let channels = sums.channels[scale];
            sums.pixels[scale] += (camera.width * camera.height) as u64;
            for (sum, &count) in sums.counts[scale].iter_mut().zip(&counts) {
                *sum += u64::from(count);
            }
            sums.weights[scale].par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, weights)| {
                for (weight, i) in weights.iter_mut().zip(chunk * CHUNK..) {
                    *weight += places.of(i).iter().map(|&[tile, k]| tiles[tile as usize].weights[k as usize]).sum();
                }
            });
            if channels == 0 {
                continue;
            }
            let map = &maps[scale].data;
            sums.buffers[scale].par_chunks_mut(CHUNK * channels).enumerate().for_each(|(chunk, rows)| {
                let entries = Entries { tiles: &tiles, places: &places, grid, first: chunk * CHUNK };
                gather(rows, map, channels, &entries);
            });
        }
    }
    Ok(())
}

/// For each Gaussian the tiles that hold it, ascending, and its position in them.
struct Places {
    starts: Vec<u32>,
    entries: Vec<[u32; 2]>,
}

impl Places {
    fn of(&self, i: usize) -> &[[u32; 2]] {
        &self.entries[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}

fn places<E>(tiles: &[TileSums<E>], n: usize) -> Places {
    let mut starts = vec![0_u32; n + 1];
    for &id in tiles.iter().flat_map(|t| &t.ids) {
        starts[id as usize + 1] += 1;
    }
    for i in 0..n {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut entries = vec![[0; 2]; starts[n] as usize];
    for (t, tile) in tiles.iter().enumerate() {
        for (k, &id) in tile.ids.iter().enumerate() {
            let at = &mut next[id as usize];
            entries[*at as usize] = [t as u32, k as u32];
            *at += 1;
        }
    }
    Places { starts, entries }
}

/// The (cell, weight) entries of one grid for the Gaussians from `first` on.
struct Entries<'a, E> {
    tiles: &'a [TileSums<E>],
    places: &'a Places,
    grid: usize,
    first: usize,
}

wide_kernel! {
    /// `row += sum of weight * map[cell]` for every row of `rows`, `[Gaussians, channels]`.
    fn gather(rows: &mut [E], map: &[f32], channels: usize, entries: &Entries<'_, E>) => gather_rows
}

#[inline(always)]
fn gather_rows<E: Real, const FMA: bool>(rows: &mut [E], map: &[f32], channels: usize, entries: &Entries<'_, E>) {
    for (i, row) in rows.chunks_exact_mut(channels).enumerate() {
        let places = entries.places.of(entries.first + i);
        if places.is_empty() {
            continue;
        }
        for (block, out) in row.chunks_mut(LANES).enumerate() {
            let mut sum = [E::zero(); LANES];
            for &[tile, k] in places {
                let (cells, weights) = entries.tiles[tile as usize].grids[entries.grid].of(k as usize);
                for (&cell, &weight) in cells.iter().zip(weights) {
                    let from = &map[cell as usize * channels + block * LANES..];
                    if let Some(from) = from.first_chunk::<LANES>().filter(|_| out.len() == LANES) {
                        for l in 0..LANES {
                            sum[l] = multiply_add::<E, FMA>(weight, E::of(f64::from(from[l])), sum[l]);
                        }
                    } else {
                        for (s, &x) in sum.iter_mut().zip(&from[..out.len()]) {
                            *s = multiply_add::<E, FMA>(weight, E::of(f64::from(x)), *s);
                        }
                    }
                }
            }
            for (o, s) in out.iter_mut().zip(sum) {
                *o += s;
            }
        }
    }
}
