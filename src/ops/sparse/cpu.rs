//! The CPU kernels of [`super::sparse_apply`].

use super::SparseMatrix;
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::backend::{HostBackend, Real, device_of, real_kernel};
use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;
use std::sync::Arc;

/// At most this many channels are handled together: one cache line of f32.
const LANES: usize = 16;

/// Rows of a task.
const BLOCK: usize = 64;

wide_kernel! {
    /// `out[k, :] += sum_j W[first + k, j] x[j, :]`.
    fn rows_kernel(w: &SparseMatrix, first: usize, x: &[E], channels: usize, out: &mut [E]) => rows_body
}
wide_kernel! {
    /// `sum[j, :] += W[r, j] g[r, first..first + width]` over all rows r in order.
    fn adjoint_kernel(w: &SparseMatrix, g: &[E], channels: usize, first: usize, width: usize, sum: &mut [E]) => adjoint_body
}

#[inline(always)]
fn rows_body<E: Real, const FMA: bool>(
    w: &SparseMatrix,
    first: usize,
    x: &[E],
    channels: usize,
    out: &mut [E],
) {
    for (k, out) in out.chunks_exact_mut(channels).enumerate() {
        let (columns, values) = w.row(first + k);
        for (&c, &v) in columns.iter().zip(values) {
            axpy::<E, FMA>(
                E::of(f64::from(v)),
                &x[c as usize * channels..][..channels],
                out,
            );
        }
    }
}

#[inline(always)]
fn adjoint_body<E: Real, const FMA: bool>(
    w: &SparseMatrix,
    g: &[E],
    channels: usize,
    first: usize,
    width: usize,
    sum: &mut [E],
) {
    for r in 0..w.rows() {
        let g = &g[r * channels + first..][..width];
        let (columns, values) = w.row(r);
        for (&c, &v) in columns.iter().zip(values) {
            axpy::<E, FMA>(
                E::of(f64::from(v)),
                g,
                &mut sum[c as usize * width..][..width],
            );
        }
    }
}

#[inline(always)]
fn axpy<E: Real, const FMA: bool>(a: E, x: &[E], y: &mut [E]) {
    for (y, &x) in y.iter_mut().zip(x) {
        *y = multiply_add::<E, FMA>(a, x, *y);
    }
}

impl SparseMatrix {
    /// `W x`: `x` is `[columns, channels]` row-major, the result `[rows, channels]`.
    pub fn apply<E: Real>(&self, x: &[E], channels: usize) -> Vec<E> {
        let mut out = vec![E::zero(); self.rows() * channels];
        if channels == 0 {
            return out;
        }
        out.par_chunks_mut(channels * BLOCK)
            .enumerate()
            .for_each(|(block, out)| rows_kernel(self, block * BLOCK, x, channels, out));
        out
    }

    /// `W^T g`: `g` is `[rows, channels]` row-major, the result `[columns, channels]`.
    ///
    /// Threads own disjoint channel ranges and walk the rows in order, so the sums do not depend on their number.
    pub fn apply_adjoint<E: Real>(&self, g: &[E], channels: usize) -> Vec<E> {
        let mut out = vec![E::zero(); self.columns * channels];
        let count = channels.div_ceil(LANES);
        let even = channels.div_ceil(count.max(1));
        let blocks: Vec<Vec<E>> = (0..count)
            .into_par_iter()
            .map(|block| {
                let first = block * even;
                let width = even.min(channels - first);
                let mut sum = vec![E::zero(); self.columns * width];
                adjoint_kernel(self, g, channels, first, width, &mut sum);
                sum
            })
            .collect();
        if channels > 0 {
            out.par_chunks_mut(channels)
                .enumerate()
                .for_each(|(c, out)| {
                    for (out, block) in out.chunks_mut(even).zip(&blocks) {
                        out.copy_from_slice(&block[c * out.len()..][..out.len()]);
                    }
                });
        }
        out
    }
}

/// `W x`, wherever the tensor lives.
pub(super) fn sparse_apply<B: HostBackend>(
    x: FloatTensor<B>,
    matrix: Arc<SparseMatrix>,
) -> FloatTensor<B> {
    let device = device_of::<B>(&x);
    let channels = x.shape()[1];
    real_kernel!(x, E => B::tensor::<E>(matrix.apply::<E>(&B::values(x), channels), &[matrix.rows(), channels], &device))
}

/// `W^T g`, wherever the tensor lives.
pub(super) fn sparse_apply_adjoint<B: HostBackend>(
    g: FloatTensor<B>,
    matrix: Arc<SparseMatrix>,
) -> FloatTensor<B> {
    let device = device_of::<B>(&g);
    let channels = g.shape()[1];
    real_kernel!(g, E => B::tensor::<E>(matrix.apply_adjoint::<E>(&B::values(g), channels), &[matrix.columns, channels], &device))
}
