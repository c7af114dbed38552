//! Separable convolution with the 11-tap Gaussian window of SSIM over bands of rows, zero padding.

use crate::backend::Real;
use crate::backend::simd::{multiply_add, wide_kernel};
use std::ops::Range;

/// Taps on either side of the centre.
pub(super) const RADIUS: usize = 5;
/// Taps of the window.
pub(super) const TAPS: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;

/// Normalised 1D taps; the 2D window is their outer product.
pub(super) fn taps<E: Real>() -> [E; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|k| {
        (-(k as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| E::of(w / sum))
}

/// Rows of an image, convolved horizontally, with the rows above and below that the vertical taps need.
pub(super) struct Band<E> {
    /// Scalars of a row.
    row: usize,
    /// Rows `first - RADIUS .. last + RADIUS`; zero outside the image.
    values: Vec<E>,
    taps: [E; TAPS],
}

impl<E: Real> Band<E> {
    /// The band for output rows `rows` of an image of `height` rows of `row` scalars, `channels` interleaved.
    /// `fill(r, out)` writes source row `r`.
    pub fn new(
        rows: &Range<usize>,
        height: usize,
        row: usize,
        channels: usize,
        fill: impl Fn(usize, &mut [E]),
    ) -> Self {
        let (taps, pad) = (taps(), RADIUS * channels);
        let mut values = vec![E::zero(); (rows.len() + 2 * RADIUS) * row];
        let mut source = vec![E::zero(); row + 2 * pad];
        for (k, out) in values.chunks_exact_mut(row).enumerate() {
            let Some(r) = (rows.start + k).checked_sub(RADIUS).filter(|&r| r < height) else {
                continue;
            };
            fill(r, &mut source[pad..][..row]);
            weigh(
                std::array::from_fn(|t| &source[t * channels..][..row]),
                &taps,
                out,
            );
        }
        Self { row, values, taps }
    }

    /// Variant `k` of the band, convolved in both directions.
    pub fn convolved(&self, k: usize, out: &mut [E]) {
        weigh(
            std::array::from_fn(|t| &self.values[(k + t) * self.row..][..self.row]),
            &self.taps,
            out,
        );
    }
}

wide_kernel! {
    /// `out = sum_t taps[t] rows[t]`; all slices have one length.
    fn weigh(rows: [&[E]; TAPS], taps: &[E; TAPS], out: &mut [E]) => weigh_body
}

#[inline(always)]
fn weigh_body<E: Real, const FMA: bool>(rows: [&[E]; TAPS], taps: &[E; TAPS], out: &mut [E]) {
    let n = out.len();
    let rows = rows.map(|r| &r[..n]);
    for i in 0..n {
        let mut sum = taps[0] * rows[0][i];
        for t in 1..TAPS {
            sum = multiply_add::<E, FMA>(taps[t], rows[t][i], sum);
        }
        out[i] = sum;
    }
}
