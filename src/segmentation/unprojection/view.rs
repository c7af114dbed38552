//! One view's part of the unprojection.
//!
//! First the pairs of each tile are folded to scalar weights per (Gaussian, feature cell) through the bilinear taps; then
//! every Gaussian gathers its cells' feature vectors, each once. Threads own disjoint Gaussians, which take their tiles in
//! order.

use super::Sums;
use crate::camera::Camera;
use crate::error::Result;
use crate::features::{FeatureMap, axis_taps};
use crate::ops::Real;
use crate::ops::simd::{multiply_add, wide_kernel};
use crate::raster::{Projected, Settings, Splats, TilePairs};
use rayon::prelude::*;

/// Gaussians that one task gathers for.
const CHUNK: usize = 512;
/// Channels summed in registers.
const LANES: usize = 32;

/// Bilinear taps along both axes of a grid: cells before and after each pixel centre, and the weight of the latter.
struct Taps {
    /// Cells across.
    width: usize,
    x: Vec<(usize, usize, f32)>,
    y: Vec<(usize, usize, f32)>,
    /// Grid and image have one size: every pixel reads its own cell.
    same: bool,
}

impl Taps {
    fn new([width, height]: [usize; 2], camera: &Camera) -> Self {
        let axis =
            |pixels: usize, cells| (0..pixels).map(|i| axis_taps(i as f64 + 0.5, pixels, cells)).collect::<Vec<_>>();
        let same = (width, height) == (camera.width, camera.height);
        Self { width, x: axis(camera.width, width), y: axis(camera.height, height), same }
    }
}

/// Weights of the cells of one grid, for each Gaussian of one tile.
struct Cells<E> {
    /// One past each Gaussian's last entry.
    ends: Vec<u32>,
    cells: Vec<u32>,
    weights: Vec<E>,
}

/// A tile's pairs, folded.
struct TileSums<E> {
    ids: Vec<u32>,
    weights: Vec<E>,
    /// One per grid.
    grids: Vec<Cells<E>>,
}

/// Adds the view of `camera`; `grids` lists the sizes of the maps and the scales that have them.
pub fn add<E: Real>(
    sums: &mut Sums<E>,
    splats: &Splats<'_, E>,
    camera: &Camera,
    maps: &[FeatureMap],
    grids: &[([usize; 2], Vec<usize>)],
    settings: &Settings,
) -> Result<()> {
    let projected = Projected::new(splats, camera, settings)?;
    let taps: Vec<Taps> = grids.iter().map(|(size, _)| Taps::new(*size, camera)).collect();
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

/// Folds the pairs of a tile onto the cells of every grid.
fn fold_tile<E: Real>(pairs: &TilePairs<'_, E>, taps: &[Taps]) -> TileSums<E> {
    let n = pairs.len();
    let mut out = TileSums { ids: Vec::with_capacity(n), weights: Vec::with_capacity(n), grids: Vec::new() };
    for i in 0..n {
        let (id, _, weights) = pairs.gaussian(i);
        out.ids.push(id);
        out.weights.push(weights.iter().copied().sum());
    }
    out.grids = taps.iter().map(|taps| fold_grid(pairs, taps)).collect();
    out
}

fn fold_grid<E: Real>(pairs: &TilePairs<'_, E>, taps: &Taps) -> Cells<E> {
    let edge = TilePairs::<E>::EDGE;
    let [x0, y0] = pairs.origin;
    let mut out = Cells { ends: Vec::with_capacity(pairs.len()), cells: Vec::new(), weights: Vec::new() };
    if taps.same {
        for i in 0..pairs.len() {
            let (_, pixels, weights) = pairs.gaussian(i);
            let cell = |p: &u16| ((y0 + *p as usize / edge) * taps.width + x0 + *p as usize % edge) as u32;
            out.cells.extend(pixels.iter().map(cell));
            out.weights.extend_from_slice(weights);
            out.ends.push(out.cells.len() as u32);
        }
        return out;
    }
    // The tile's window of cells, and taps relative to its corner.
    let xs = &taps.x[x0..(x0 + edge).min(taps.x.len())];
    let ys = &taps.y[y0..(y0 + edge).min(taps.y.len())];
    let (Some(&(left, ..)), Some(&(top, ..))) = (xs.first(), ys.first()) else { return out };
    let columns = xs.iter().map(|t| t.1).max().unwrap_or(left) + 1 - left;
    let rows = ys.iter().map(|t| t.1).max().unwrap_or(top) + 1 - top;
    let xs: Vec<(usize, usize, E)> = xs.iter().map(|&(a, b, f)| (a - left, b - left, E::of(f64::from(f)))).collect();
    let ys: Vec<(usize, usize, E)> =
        ys.iter().map(|&(a, b, f)| ((a - top) * columns, (b - top) * columns, E::of(f64::from(f)))).collect();
    let mut window = vec![E::zero(); rows * columns];
    for i in 0..pairs.len() {
        let (_, pixels, weights) = pairs.gaussian(i);
        let (Some(&first), Some(&last)) = (pixels.first(), pixels.last()) else {
            out.ends.push(out.cells.len() as u32);
            continue;
        };
        for (&pixel, &weight) in pixels.iter().zip(weights) {
            let ((xa, xb, fx), (ya, yb, fy)) = (xs[pixel as usize % edge], ys[pixel as usize / edge]);
            let below = weight * fy;
            let above = weight - below;
            let (above_right, below_right) = (above * fx, below * fx);
            window[ya + xa] += above - above_right;
            window[ya + xb] += above_right;
            window[yb + xa] += below - below_right;
            window[yb + xb] += below_right;
        }
        // Rows ascend with the pixels, so only these were touched.
        let touched = ys[first as usize / edge].0..ys[last as usize / edge].1 + columns;
        for (weight, at) in window[touched.clone()].iter_mut().zip(touched) {
            if *weight != E::zero() {
                out.cells.push(((top + at / columns) * taps.width + left + at % columns) as u32);
                out.weights.push(std::mem::take(weight));
            }
        }
        out.ends.push(out.cells.len() as u32);
    }
    out
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
                let cells = &entries.tiles[tile as usize].grids[entries.grid];
                let k = k as usize;
                let start = if k == 0 { 0 } else { cells.ends[k - 1] as usize };
                let span = start..cells.ends[k] as usize;
                for (&cell, &weight) in cells.cells[span.clone()].iter().zip(&cells.weights[span]) {
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
