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
use std::ops::Range;

/// Lanes summed in registers.
const LANES: usize = 16;

/// Cells before and after a pixel centre along one axis, and the weight of the latter.
type Tap = (usize, usize, f32);

/// Bilinear taps along both axes of a grid.
pub struct Taps {
    /// Cells across.
    width: usize,
    x: Vec<Tap>,
    y: Vec<Tap>,
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

impl BilinearGrid {
    /// The grid of the taps `x` and `y` of a tile, with the lanes from `lane` on; `width` cells across.
    fn new(width: usize, x: &[Tap], y: &[Tap], lane: usize) -> Self {
        let [left, top] = [x, y].map(|taps| taps.first().map_or(0, |tap| tap.0));
        let span = |tap: &Tap, first: usize| [tap.0 - first, tap.1 + 1 - first];
        Self {
            width,
            lane,
            left,
            top,
            columns: x.iter().map(|tap| span(tap, left)).collect(),
            rows: y.iter().map(|tap| span(tap, top)).collect(),
        }
    }

    /// Its lanes: one for each column of cells that the tile reaches.
    fn lanes(&self) -> Range<usize> {
        self.lane..self.lane + self.columns.last().map_or(0, |span| span[1])
    }

    /// Adds the taps `x` to `[pixel columns, lanes]`.
    fn add_columns<E: Real>(&self, x: &[Tap], lanes: usize, weights: &mut [E]) {
        for (pixel, &(a, b, f)) in x.iter().enumerate() {
            let f = E::of(f64::from(f));
            let at = pixel * lanes + self.lane;
            weights[at + a - self.left] += E::one() - f;
            weights[at + b - self.left] += f;
        }
    }

    /// Adds the taps `y` to `[pixel rows, rows, lanes]`.
    fn add_rows<E: Real>(&self, y: &[Tap], rows: usize, lanes: usize, weights: &mut [E]) {
        let own = self.lanes();
        for (pixel, &(a, b, f)) in y.iter().enumerate() {
            let f = E::of(f64::from(f));
            for (row, weight) in [(a - self.top, E::one() - f), (b - self.top, f)] {
                let at = (pixel * rows + row) * lanes;
                let weights = weights[at..][own.clone()].iter_mut();
                weights.for_each(|w| *w += weight);
            }
        }
    }
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
            let [x, y] = [clipped(&taps.x, x0, edge), clipped(&taps.y, y0, edge)];
            let grid = BilinearGrid::new(taps.width, x, y, lanes);
            for (reach, own) in reach.iter_mut().zip(&grid.rows) {
                *reach = [reach[0].min(own[0]), reach[1].max(own[1])];
            }
            lanes = grid.lanes().end;
            rows = rows.max(grid.rows.last().map_or(0, |span| span[1]));
            grids.push(GridReading::Bilinear(grid));
        }
        lanes = lanes.next_multiple_of(LANES);
        let mut column_weights = vec![E::zero(); edge * lanes];
        let mut row_weights = vec![E::zero(); edge * rows * lanes];
        for (reading, taps) in grids.iter().zip(taps) {
            if let GridReading::Bilinear(grid) = reading {
                grid.add_columns(clipped(&taps.x, x0, edge), lanes, &mut column_weights);
                grid.add_rows(clipped(&taps.y, y0, edge), rows, lanes, &mut row_weights);
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
            len = match reading {
                GridReading::Pixels { width } => {
                    add_pixels(pairs.origin, *width, pixels, weights, out, len)
                }
                GridReading::Bilinear(grid) => {
                    let columns = grid.columns[left][0]..grid.columns[right][1];
                    let rows = grid.rows[top][0]..grid.rows[bottom][1];
                    add_cells(grid, columns, rows, &sums, lanes, out, len)
                }
            };
            *end = len as u32 - entry.at;
        }
        sums.fill(E::zero());
    }
    out.truncate(len);
}

/// Writes the weights of one Gaussian in a grid whose cells are pixels to `out` from `len` on; returns the end.
#[inline(always)]
fn add_pixels<E: Real>(
    origin: [usize; 2],
    width: usize,
    pixels: &[u16],
    weights: &[E],
    out: &mut Vec<CellWeight<E>>,
    len: usize,
) -> usize {
    make_room(out, len + pixels.len());
    let edge = TilePairs::<E>::EDGE as u32;
    let [x, y] = origin.map(|o| o as u32);
    for (to, (&pixel, &weight)) in out[len..].iter_mut().zip(pixels.iter().zip(weights)) {
        let row = u32::from(pixel) / edge;
        let column = u32::from(pixel) % edge;
        let cell = (y + row) * width as u32 + x + column;
        *to = CellWeight { cell, weight };
    }
    len + pixels.len()
}

/// Writes `sums`, `[rows, lanes]`, of the cells in `columns` and `rows` of `grid` to `out` from `len` on; returns the end.
#[inline(always)]
fn add_cells<E: Real>(
    grid: &BilinearGrid,
    columns: Range<usize>,
    rows: Range<usize>,
    sums: &[E],
    lanes: usize,
    out: &mut Vec<CellWeight<E>>,
    mut len: usize,
) -> usize {
    make_room(out, len + rows.len() * columns.len());
    for row in rows {
        let first = ((grid.top + row) * grid.width + grid.left + columns.start) as u32;
        let weights = &sums[row * lanes + grid.lane..][columns.clone()];
        for (cell, &weight) in (first..).zip(weights) {
            // Cells without weight are written over.
            out[len] = CellWeight { cell, weight };
            len += usize::from(weight != E::zero());
        }
    }
    len
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
