//! Multi-head self-attention, a chunk of queries at a time.

use super::HEAD;
use super::kernels::{LOG2_E, softmax_numerators};
use super::layers::Linear;
use crate::error::{Error, Result};
use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2, s};
use rayon::prelude::*;

/// Queries, keys and values larger than this could overflow in a dot product of [`HEAD`] terms.
const LARGEST: f32 = 1e18;

/// Adds the projected attention of all heads to the tokens `x`, `[n, d]`. `qkv` is `[n, 3 d]`: queries, keys, values, each
/// head by head. `block` names the block in errors.
///
/// # Errors
/// [`Error::NonFinite`] when `qkv` holds what is not finite or too large to multiply.
pub(super) fn attend(
    qkv: &[f32],
    d: usize,
    queries: usize,
    x: &mut [f32],
    projection: &Linear,
    block: usize,
) -> Result<()> {
    let fits = |v: &f32| v.abs() <= LARGEST;
    // Without early exits inside a row: the compiler makes it wide.
    if !qkv
        .par_chunks_exact(3 * d)
        .all(|row| row.iter().fold(true, |all, v| all & fits(v)))
    {
        let row = qkv
            .chunks_exact(3 * d)
            .position(|row| !row.iter().all(fits))
            .unwrap_or_default();
        return Err(Error::non_finite(
            format!("attention of DINO block {block}"),
            row,
        ));
    }
    let n = x.len() / d;
    let Ok(all) = ArrayView2::from_shape((n, 3 * d), qkv) else {
        unreachable!("three times the tokens' length")
    };
    let queries = queries.min(n);
    // Scores are kept from chunk to chunk: fresh pages cost more than clearing them would.
    x.par_chunks_mut(queries * d).enumerate().for_each_init(
        Vec::new,
        |scores: &mut Vec<f32>, (chunk, x)| {
            let (first, count) = (chunk * queries, x.len() / d);
            scores.resize(count * n, 0.0);
            let mut attended = vec![0.0; count * d];
            for head in (0..d).step_by(HEAD) {
                let part = |which: usize| which * d + head..which * d + head + HEAD;
                let query = all.slice(s![first..first + count, part(0)]);
                let (keys, values) = (all.slice(s![.., part(1)]), all.slice(s![.., part(2)]));
                // Scores in powers of two: the exponential is that of base 2.
                let scale = LOG2_E / (HEAD as f32).sqrt();
                product(scale, &query, &keys.t(), &mut matrix(scores, n).view_mut());
                let sums: Vec<f32> = scores.chunks_exact_mut(n).map(softmax_numerators).collect();
                let mut attended = matrix(&mut attended, d);
                let mut out = attended.slice_mut(s![.., head..head + HEAD]);
                product(
                    1.0,
                    &ArrayView2::from(&matrix(scores, n)),
                    &values,
                    &mut out,
                );
                for (mut row, sum) in out.rows_mut().into_iter().zip(sums) {
                    row.iter_mut().for_each(|v| *v /= sum);
                }
            }
            projection.add_to(&attended, x);
        },
    );
    Ok(())
}

fn product(scale: f32, a: &ArrayView2<f32>, b: &ArrayView2<f32>, out: &mut ArrayViewMut2<f32>) {
    general_mat_mul(scale, a, b, 0.0, out);
}

/// Variant-major values as rows of `columns`.
fn matrix(values: &mut [f32], columns: usize) -> ArrayViewMut2<'_, f32> {
    let rows = values.len() / columns;
    match ArrayViewMut2::from_shape((rows, columns), values) {
        Ok(view) => view,
        Err(error) => unreachable!("{rows} whole rows of {columns}: {error}"),
    }
}
