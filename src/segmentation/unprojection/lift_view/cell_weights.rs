//! Scalar weights of a tile's Gaussians on the cells of feature maps: blending weights times bilinear taps.
//!
//! The bilinear taps are separable. A tile touches few columns and rows of each grid. The columns of all grids lie side by side
//! in lanes. For each row of pixels, a Gaussian's weights are summed into the lanes by the taps along x. Then the lanes are added
//! to the rows of cells by the taps along y.

use crate::backend::Real;
use crate::backend::simd::{multiply_add, prefetch, wide_kernel};
use crate::features::{Axis, Lattice, SCALES};
use crate::raster::TilePairs;
use crate::splat::camera::Camera;

/// Lanes summed in registers.
const LANES: usize = 16;

/// Bilinear taps along both axes of a grid: cells before and after each pixel centre, and the weight of the latter.
pub struct Taps {
    /// Cells across.
    width: usize,
    x: Vec<(usize, usize, f32)>,
    y: Vec<(usize, usize, f32)>,
    /// Grid and image have one size: every pixel reads its own cell.
    is_of_pixels: bool,
}

impl Taps {
    /// Taps of the cells of `lattice` at the pixels of `camera`.
    pub fn new(lattice: &Lattice, camera: &Camera) -> Self {
        let of =
            |axis: Axis, pixels: usize| (0..pixels).map(|i| axis.taps(i as f64 + 0.5)).collect();
        Self {
            width: lattice.width,
            x: of(lattice.columns(camera.width), camera.width),
            y: of(lattice.rows(camera.height), camera.height),
            is_of_pixels: lattice.is_of_pixels(camera.width, camera.height),
        }
    }
}

/// Weight of a cell of a grid.
#[derive(Clone, Copy, Debug, Default)]
pub struct CellWeight<E> {
    pub cell: u32,
    pub weight: E,
}

/// One Gaussian in one tile.
#[derive(Clone, Copy, Debug, Default)]
pub struct Entry<E> {
    /// Sum of its weights.
    pub weight: E,
    /// Number of the tile, and where this Gaussian begins in the tile's list.
    tile: u32,
    at: u32,
    /// For each grid one past its last cell, from `at`.
    ends: [u32; SCALES],
}

impl<E: Real> Entry<E> {
    /// Prefetches its cells.
    #[inline(always)]
    pub fn prefetch(&self, tiles: &[Vec<CellWeight<E>>]) {
        if let Some(first) = tiles[self.tile as usize].get(self.at as usize) {
            prefetch(first);
        }
    }

    /// Cells of `grid` that the Gaussian touches; `tiles` are the lists that [`tile_cell_weights`] made.
    #[inline(always)]
    pub fn cells<'a>(&self, tiles: &'a [Vec<CellWeight<E>>], grid: usize) -> &'a [CellWeight<E>] {
        let start = if grid == 0 { 0 } else { self.ends[grid - 1] };
        &tiles[self.tile as usize][(self.at + start) as usize..(self.at + self.ends[grid]) as usize]
    }
}

/// Weights of the Gaussians of the tile with number `tile` on the cells of every grid, at most [`SCALES`] grids. `entries` has
/// one for each of its Gaussians. Returns the cells of the first Gaussian grid by grid, then those of the next.
pub fn tile_cell_weights<E: Real>(
    tile: usize,
    pairs: &TilePairs<E>,
    taps: &[Taps],
    entries: &mut [Entry<E>],
) -> Vec<CellWeight<E>> {
    let grids = TileGrids::new(pairs.origin, TilePairs::<E>::EDGE, taps);
    let mut cells = Vec::new();
    for entry in entries.iter_mut() {
        entry.tile = tile as u32;
    }
    cell_weights(pairs, &grids, entries, &mut cells);
    cells
}

/// How a tile reads one grid.
enum GridReading {
    /// Its cells are the pixels; `width` of them across.
    Pixels { width: usize },
    /// Through bilinear taps.
    Bilinear(BilinearGrid),
}

/// The lanes of one grid.
struct BilinearGrid {
    /// Cells across the whole grid.
    width: usize,
    /// First lane, and the first column and row of cells that the tile reaches.
    lane: usize,
    left: usize,
    top: usize,
    /// For each column and row of pixels the cells it reaches: the first and one past the last, from `left` and `top`.
    columns: Vec<[usize; 2]>,
    rows: Vec<[usize; 2]>,
}

/// What a tile reads of the grids.
struct TileGrids<E> {
    /// One per grid.
    grids: Vec<GridReading>,
    /// Lanes of all bilinear grids, a multiple of [`LANES`].
    lanes: usize,
    /// Largest number of rows of cells that the tile reaches in a bilinear grid.
    rows: usize,
    /// For each row of pixels the first row of cells that it reaches in any bilinear grid, and one past the last.
    reach: Vec<[usize; 2]>,
    /// `[pixel columns, lanes]`: weight of a column of pixels in each lane.
    column_weights: Vec<E>,
    /// `[pixel rows, rows, lanes]`: weight of a row of pixels in each row of cells, for each lane.
    row_weights: Vec<E>,
}

impl<E: Real> TileGrids<E> {
    fn new([x0, y0]: [usize; 2], edge: usize, taps: &[Taps]) -> Self {
        let mut grids = Vec::with_capacity(taps.len());
        let mut lanes = 0;
        let mut rows = 0;
        let mut reach = vec![[usize::MAX, 0]; edge];
        for taps in taps {
            if taps.is_of_pixels {
                grids.push(GridReading::Pixels { width: taps.width });
                continue;
            }
            let span = |taps: &[(usize, usize, f32)], from: usize| -> (usize, Vec<[usize; 2]>) {
                let taps = clipped(taps, from, edge);
                let first = taps.first().map_or(0, |t| t.0);
                (
                    first,
                    taps.iter()
                        .map(|t| [t.0 - first, t.1 + 1 - first])
                        .collect(),
                )
            };
            let (left, columns) = span(&taps.x, x0);
            let (top, own) = span(&taps.y, y0);
            for (reach, own) in reach.iter_mut().zip(&own) {
                *reach = [reach[0].min(own[0]), reach[1].max(own[1])];
            }
            let end = |spans: &[[usize; 2]]| spans.last().map_or(0, |s| s[1]);
            let lane = lanes;
            lanes += end(&columns);
            rows = rows.max(end(&own));
            grids.push(GridReading::Bilinear(BilinearGrid {
                width: taps.width,
                lane,
                left,
                top,
                columns,
                rows: own,
            }));
        }
        lanes = lanes.next_multiple_of(LANES);
        let mut column_weights = vec![E::zero(); edge * lanes];
        let mut row_weights = vec![E::zero(); edge * rows * lanes];
        for (reading, taps) in grids.iter().zip(taps) {
            let GridReading::Bilinear(grid) = reading else {
                continue;
            };
            for (pixel, &(a, b, f)) in clipped(&taps.x, x0, edge).iter().enumerate() {
                let f = E::of(f64::from(f));
                let at = pixel * lanes + grid.lane;
                column_weights[at + a - grid.left] += E::one() - f;
                column_weights[at + b - grid.left] += f;
            }
            let own = grid.lane..grid.lane + grid.columns.last().map_or(0, |c| c[1]);
            for (pixel, &(a, b, f)) in clipped(&taps.y, y0, edge).iter().enumerate() {
                let f = E::of(f64::from(f));
                for (row, weight) in [(a - grid.top, E::one() - f), (b - grid.top, f)] {
                    let at = (pixel * rows + row) * lanes;
                    row_weights[at..][own.clone()]
                        .iter_mut()
                        .for_each(|w| *w += weight);
                }
            }
        }
        Self {
            grids,
            lanes,
            rows,
            reach,
            column_weights,
            row_weights,
        }
    }
}

fn clipped<T>(all: &[T], from: usize, len: usize) -> &[T] {
    &all[from.min(all.len())..(from + len).min(all.len())]
}

wide_kernel! {
    /// The cell weights of all Gaussians of a tile.
    fn cell_weights(
        pairs: &TilePairs<E>, grids: &TileGrids<E>, entries: &mut [Entry<E>], out: &mut Vec<CellWeight<E>>,
    ) => add_cell_weights
}

#[inline(always)]
fn add_cell_weights<E: Real, const FMA: bool>(
    pairs: &TilePairs<E>,
    grids: &TileGrids<E>,
    entries: &mut [Entry<E>],
    out: &mut Vec<CellWeight<E>>,
) {
    let edge = TilePairs::<E>::EDGE;
    let lanes = grids.lanes;
    let mut sums = vec![E::zero(); grids.rows * lanes];
    // `out` is longer than needed, so that writing a cell needs no capacity check.
    let mut len = 0;
    for (i, entry) in entries.iter_mut().enumerate().take(pairs.len()) {
        let (pixels, weights) = pairs.gaussian(i);
        let (Some(&first), Some(&last)) = (pixels.first(), pixels.last()) else {
            continue;
        };
        let [top, bottom] = [first, last].map(|pixel| usize::from(pixel) / edge);
        // Only bilinear grids read the columns, and without lanes there are none.
        let [left, right] = if lanes > 0 {
            add_gaussian::<E, FMA>(grids, pixels, weights, &mut sums)
        } else {
            [0, edge - 1]
        };
        entry.weight = weights.iter().copied().sum();
        entry.at = len as u32;
        for (end, reading) in entry.ends.iter_mut().zip(&grids.grids) {
            match reading {
                GridReading::Pixels { width } => {
                    make_room(out, len + pixels.len());
                    let [x, y] = pairs.origin.map(|o| o as u32);
                    for (to, (&pixel, &weight)) in
                        out[len..].iter_mut().zip(pixels.iter().zip(weights))
                    {
                        let row = u32::from(pixel) / edge as u32;
                        let column = u32::from(pixel) % edge as u32;
                        *to = CellWeight {
                            cell: (y + row) * *width as u32 + x + column,
                            weight,
                        };
                    }
                    len += pixels.len();
                }
                GridReading::Bilinear(grid) => {
                    let columns = grid.columns[left][0]..grid.columns[right][1];
                    let rows = grid.rows[top][0]..grid.rows[bottom][1];
                    make_room(out, len + rows.len() * columns.len());
                    for row in rows {
                        let first =
                            ((grid.top + row) * grid.width + grid.left + columns.start) as u32;
                        let weights = &sums[row * lanes + grid.lane..][columns.clone()];
                        for (cell, &weight) in (first..).zip(weights) {
                            // Cells without weight are written over.
                            out[len] = CellWeight { cell, weight };
                            len += usize::from(weight != E::zero());
                        }
                    }
                }
            }
            *end = len as u32 - entry.at;
        }
        sums.fill(E::zero());
    }
    out.truncate(len);
}

/// Adds the pairs of one Gaussian to `sums`, `[rows, lanes]`; returns its first and last column of pixels.
#[inline(always)]
fn add_gaussian<E: Real, const FMA: bool>(
    grids: &TileGrids<E>,
    pixels: &[u16],
    weights: &[E],
    sums: &mut [E],
) -> [usize; 2] {
    let edge = TilePairs::<E>::EDGE;
    let lanes = grids.lanes;
    let mut left = edge;
    let mut right = 0;
    let mut from = 0;
    while from < pixels.len() {
        // Pixels of one row.
        let y = usize::from(pixels[from]) / edge;
        let to = from
            + pixels[from..]
                .iter()
                .take_while(|&&p| usize::from(p) / edge == y)
                .count();
        left = left.min(usize::from(pixels[from]) % edge);
        right = right.max(usize::from(pixels[to - 1]) % edge);
        let [low, high] = grids.reach[y];
        for block in (0..lanes).step_by(LANES) {
            let mut sum = [E::zero(); LANES];
            for (&pixel, &weight) in pixels[from..to].iter().zip(&weights[from..to]) {
                let at = usize::from(pixel) % edge * lanes + block;
                let Some(taps) = grids.column_weights[at..].first_chunk::<LANES>() else {
                    continue;
                };
                for l in 0..LANES {
                    sum[l] = multiply_add::<E, FMA>(weight, taps[l], sum[l]);
                }
            }
            for row in low..high {
                let taps = &grids.row_weights[(y * grids.rows + row) * lanes + block..];
                let (Some(sums), Some(taps)) = (
                    sums[row * lanes + block..].first_chunk_mut::<LANES>(),
                    taps.first_chunk::<LANES>(),
                ) else {
                    continue;
                };
                for l in 0..LANES {
                    sums[l] = multiply_add::<E, FMA>(taps[l], sum[l], sums[l]);
                }
            }
        }
        from = to;
    }
    [left, right]
}

/// Makes `list` at least `len` long.
#[inline(always)]
fn make_room<E: Real>(list: &mut Vec<CellWeight<E>>, len: usize) {
    if list.len() < len {
        list.resize((2 * list.len()).max(len).max(1024), CellWeight::default());
    }
}
