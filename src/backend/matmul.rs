//! Small dense products on slices, one call a block of rows.

use super::Real;
use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};

/// A row-major matrix that is read.
fn view<E>(values: &[E], columns: usize) -> ArrayView2<'_, E> {
    let rows = values.len() / columns.max(1);
    match ArrayView2::from_shape((rows, columns), &values[..rows * columns]) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} of a slice cut to that length: {error}"),
    }
}

fn view_mut<E>(values: &mut [E], columns: usize) -> ArrayViewMut2<'_, E> {
    let rows = values.len() / columns.max(1);
    match ArrayViewMut2::from_shape((rows, columns), &mut values[..rows * columns]) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} x {columns} of a slice cut to that length: {error}"),
    }
}

/// `out += a b`: `a` is `[m, k]`, `b` `[k, n]`, `out` `[m, n]`, all row-major.
pub(crate) fn add_product<E: Real>(a: &[E], k: usize, b: &[E], n: usize, out: &mut [E]) {
    if k > 0 && n > 0 {
        general_mat_mul(
            E::one(),
            &view(a, k),
            &view(b, n),
            E::one(),
            &mut view_mut(out, n),
        );
    }
}
