//! Bilinear interpolation on grids whose cell in column i and row j lies at the coordinates (i, j).

use num_traits::Float;

/// The two cells beside the coordinate `at` of an axis with `cells` cells, and the share of the second one. A coordinate outside,
/// or one that is not a number, takes the border.
pub(crate) fn beside(at: f64, cells: usize) -> (usize, usize, f64) {
    let last = cells.saturating_sub(1);
    let at = at.max(0.0).min(last as f64);
    let first = at as usize;
    (first, (first + 1).min(last), at.fract())
}

/// The value among four cells: left and right of the upper row, then of the lower one. `x` and `y` are the shares of the right cells
/// and of the lower row.
pub(crate) fn among<T: Float>([a, b, c, d]: [T; 4], x: T, y: T) -> T {
    let (upper, lower) = (a + x * (b - a), c + x * (d - c));
    upper + y * (lower - upper)
}
