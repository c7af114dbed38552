//! The pairs of a tile folded to scalar weights per (Gaussian, feature cell).
//!
//! The bilinear taps are separable. A tile touches few columns and rows of each grid; the columns of all grids lie side
//! by side in lanes. A Gaussian's pixels of one row are spread over the lanes first, then the lanes over the rows.

use crate::camera::Camera;
use crate::features::{Axis, Lattice};
use crate::ops::Real;
use crate::ops::simd::{multiply_add, wide_kernel};
use crate::raster::TilePairs;

/// Lanes summed in registers.
const LANES: usize = 16;

/// Bilinear taps along both axes of a grid: cells before and after each pixel centre, and the weight of the latter.
pub struct Taps {
    /// Cells across.
    width: usize,
    x: Vec<(usize, usize, f32)>,
    y: Vec<(usize, usize, f32)>,
    /// Grid and image have one size: every pixel reads its own cell.
    same: bool,
}

impl Taps {
    /// Of the cells of `lattice` over the image of `camera`.
    pub fn new(lattice: &Lattice, camera: &Camera) -> Self {
        let of = |axis: Axis, pixels: usize| (0..pixels).map(|i| axis.taps(i as f64 + 0.5)).collect();
        let (x, y) = (lattice.columns(camera.width), lattice.rows(camera.height));
        let same = lattice.is_of_pixels(camera.width, camera.height);
        Self { width: lattice.width, x: of(x, camera.width), y: of(y, camera.height), same }
    }
}

/// Weights of the cells of one grid, for each Gaussian of one tile.
#[derive(Default)]
pub struct Cells<E> {
    /// One past each Gaussian's last entry.
    ends: Vec<u32>,
    cells: Vec<u32>,
    weights: Vec<E>,
}

impl<E> Cells<E> {
    /// Cells and weights of the tile's `k`-th Gaussian.
    #[inline(always)]
    pub fn of(&self, k: usize) -> (&[u32], &[E]) {
        let start = if k == 0 { 0 } else { self.ends[k - 1] as usize };
        let span = start..self.ends[k] as usize;
        (&self.cells[span.clone()], &self.weights[span])
    }
}

/// A tile's pairs, folded.
pub struct TileSums<E> {
    /// The Gaussians, front to back.
    pub ids: Vec<u32>,
    /// Sum of each one's weights.
    pub weights: Vec<E>,
    /// One per grid.
    pub grids: Vec<Cells<E>>,
}

/// Folds the pairs of a tile onto the cells of every grid.
pub fn fold_tile<E: Real>(pairs: &TilePairs<'_, E>, taps: &[Taps]) -> TileSums<E> {
    let n = pairs.len();
    let empty = |_: &Taps| Cells { ends: Vec::with_capacity(n), cells: Vec::new(), weights: Vec::new() };
    let mut out = TileSums {
        ids: Vec::with_capacity(n),
        weights: Vec::with_capacity(n),
        grids: taps.iter().map(empty).collect(),
    };
    for i in 0..n {
        let (id, _, weights) = pairs.gaussian(i);
        out.ids.push(id);
        out.weights.push(weights.iter().copied().sum());
    }
    for (taps, grid) in taps.iter().zip(&mut out.grids).filter(|(taps, _)| taps.same) {
        copy(pairs, taps.width, grid);
    }
    let window = Window::new(pairs.origin, TilePairs::<E>::EDGE, taps);
    if !window.bands.is_empty() {
        fold(pairs, &window, &mut out.grids);
    }
    out
}

/// Every pair is an entry.
fn copy<E: Real>(pairs: &TilePairs<'_, E>, width: usize, out: &mut Cells<E>) {
    let edge = TilePairs::<E>::EDGE;
    let [x0, y0] = pairs.origin;
    for i in 0..pairs.len() {
        let (_, pixels, weights) = pairs.gaussian(i);
        out.cells.extend(pixels.iter().map(|&p| ((y0 + p as usize / edge) * width + x0 + p as usize % edge) as u32));
        out.weights.extend_from_slice(weights);
        out.ends.push(out.cells.len() as u32);
    }
}

/// The lanes of one grid.
struct Band {
    grid: usize,
    /// Cells across the whole grid.
    width: usize,
    lanes: std::ops::Range<usize>,
    /// First column and row of cells.
    left: usize,
    top: usize,
    /// For each row of pixels the first and one past the last row it reaches, from `top`.
    rows: Vec<[usize; 2]>,
}

/// What a tile reads of the grids.
struct Window<E> {
    bands: Vec<Band>,
    /// Lanes, a multiple of [`LANES`].
    lanes: usize,
    /// Rows of cells of the grid that has most.
    rows: usize,
    /// `[pixel columns, lanes]`: weight of a column of pixels in each lane.
    columns: Vec<E>,
    /// `[pixel rows, rows, lanes]`: weight of a row of pixels in each row of each lane's grid.
    across: Vec<E>,
}

impl<E: Real> Window<E> {
    fn new([x0, y0]: [usize; 2], edge: usize, taps: &[Taps]) -> Self {
        let mut out = Self { bands: vec![], lanes: 0, rows: 0, columns: vec![], across: vec![] };
        for (grid, taps) in taps.iter().enumerate().filter(|(_, taps)| !taps.same) {
            let (xs, ys) = (part(&taps.x, x0, edge), part(&taps.y, y0, edge));
            let (Some(first), Some(last), Some(above), Some(below)) = (xs.first(), xs.last(), ys.first(), ys.last())
            else {
                continue;
            };
            let (left, top) = (first.0, above.0);
            let lanes = out.lanes..out.lanes + last.1 + 1 - left;
            let rows = ys.iter().map(|t| [t.0 - top, t.1 + 1 - top]).collect();
            out.lanes = lanes.end;
            out.rows = out.rows.max(below.1 + 1 - top);
            out.bands.push(Band { grid, width: taps.width, lanes, left, top, rows });
        }
        out.lanes = out.lanes.next_multiple_of(LANES);
        out.columns = vec![E::zero(); edge * out.lanes];
        out.across = vec![E::zero(); edge * out.rows * out.lanes];
        for band in &out.bands {
            let taps = &taps[band.grid];
            for (pixel, &(a, b, f)) in part(&taps.x, x0, edge).iter().enumerate() {
                let f = E::of(f64::from(f));
                let at = pixel * out.lanes + band.lanes.start - band.left;
                out.columns[at + a] += E::one() - f;
                out.columns[at + b] += f;
            }
            for (pixel, &(a, b, f)) in part(&taps.y, y0, edge).iter().enumerate() {
                let f = E::of(f64::from(f));
                for (row, weight) in [(a - band.top, E::one() - f), (b - band.top, f)] {
                    let at = (pixel * out.rows + row) * out.lanes;
                    out.across[at..][band.lanes.clone()].iter_mut().for_each(|w| *w += weight);
                }
            }
        }
        out
    }
}

fn part<T>(all: &[T], from: usize, len: usize) -> &[T] {
    &all[from.min(all.len())..(from + len).min(all.len())]
}

wide_kernel! {
    /// Folds all Gaussians of a tile onto the window.
    fn fold(pairs: &TilePairs<'_, E>, window: &Window<E>, out: &mut [Cells<E>]) => fold_all
}

#[inline(always)]
fn fold_all<E: Real, const FMA: bool>(pairs: &TilePairs<'_, E>, window: &Window<E>, out: &mut [Cells<E>]) {
    let edge = TilePairs::<E>::EDGE;
    let lanes = window.lanes;
    let mut sums = vec![E::zero(); window.rows * lanes];
    for i in 0..pairs.len() {
        let (_, pixels, weights) = pairs.gaussian(i);
        let mut from = 0;
        while from < pixels.len() {
            // Pixels of one row.
            let y = pixels[from] as usize / edge;
            let mut to = from + 1;
            while to < pixels.len() && pixels[to] as usize / edge == y {
                to += 1;
            }
            let across = &window.across[y * window.rows * lanes..][..window.rows * lanes];
            for block in (0..lanes).step_by(LANES) {
                let mut sum = [E::zero(); LANES];
                for (&pixel, &weight) in pixels[from..to].iter().zip(&weights[from..to]) {
                    let at = pixel as usize % edge * lanes + block;
                    let Some(column) = window.columns[at..].first_chunk::<LANES>() else { continue };
                    for l in 0..LANES {
                        sum[l] = multiply_add::<E, FMA>(weight, column[l], sum[l]);
                    }
                }
                for row in 0..window.rows {
                    let at = row * lanes + block;
                    let (Some(out), Some(weight)) =
                        (sums[at..].first_chunk_mut::<LANES>(), across[at..].first_chunk::<LANES>())
                    else {
                        continue;
                    };
                    for l in 0..LANES {
                        out[l] = multiply_add::<E, FMA>(weight[l], sum[l], out[l]);
                    }
                }
            }
            from = to;
        }
        let (first, last) = (pixels.first().copied().unwrap_or(0), pixels.last().copied().unwrap_or(0));
        for band in &window.bands {
            let grid = &mut out[band.grid];
            let touched = band.rows[first as usize / edge][0]..band.rows[last as usize / edge][1];
            for row in touched {
                let cell = (band.top + row) * band.width + band.left;
                for (k, &weight) in sums[row * lanes..][band.lanes.clone()].iter().enumerate() {
                    if weight != E::zero() {
                        grid.cells.push((cell + k) as u32);
                        grid.weights.push(weight);
                    }
                }
            }
            grid.ends.push(grid.cells.len() as u32);
        }
        sums.fill(E::zero());
    }
}
