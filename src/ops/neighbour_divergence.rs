//! The 3D regularisation (Eq. 9) as a fused operation: value and gradient together, each row's softmax taken once.

use super::gradient_in_hand::with_gradient_in_hand;
use super::sparse::{SparseMatrix, sparse_apply};
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::Tensor;
use burn::tensor::activation::log_softmax;
use rayon::prelude::*;
use std::sync::Arc;

/// Sampled rows in a task; also the unit of the fixed summation order.
const PART: usize = 512;
/// Rows in a task of the softmax.
const BLOCK: usize = 64;

/// Rows and their neighbours.
#[derive(Clone, Debug)]
pub struct NeighbourPairs {
    /// The M sampled rows.
    pub chosen: Vec<u32>,
    /// Their neighbours, `[M, K]`.
    pub neighbours: Vec<u32>,
}

impl NeighbourPairs {
    /// The sampled rows with those of `table`, `[N, k]`.
    ///
    /// # Panics
    /// If a sampled row is not below N.
    pub fn new(chosen: Vec<u32>, table: &[u32], k: usize) -> Self {
        let neighbours = chosen
            .iter()
            .flat_map(|&j| &table[j as usize * k..][..k])
            .copied()
            .collect();
        Self { chosen, neighbours }
    }

    /// The mean over all pairs of D_KL(softmax f_j || softmax f_k), and its gradient; `features` is `[N, width]`.
    pub fn value_and_gradient<E: Real>(&self, features: &[E], width: usize) -> (E, Vec<E>) {
        let mut gradient = vec![E::zero(); features.len()];
        if self.neighbours.is_empty() || width == 0 {
            return (E::zero(), gradient);
        }
        let (mut log_p, mut p) = (features.to_vec(), gradient.clone());
        log_p
            .par_chunks_mut(BLOCK * width)
            .zip(p.par_chunks_mut(BLOCK * width))
            .for_each(|(log_p, p)| {
                for (log_p, p) in log_p.chunks_exact_mut(width).zip(p.chunks_exact_mut(width)) {
                    let highest = log_p
                        .iter()
                        .fold(log_p[0], |h, &z| if z > h { z } else { h });
                    p.iter_mut()
                        .zip(&*log_p)
                        .for_each(|(p, &z)| *p = (z - highest).exp());
                    let total: E = p.iter().copied().sum();
                    let (shift, factor) = (highest + total.ln(), E::one() / total);
                    log_p.iter_mut().for_each(|z| *z -= shift);
                    p.iter_mut().for_each(|p| *p *= factor);
                }
            });
        let k = self.neighbours.len() / self.chosen.len();
        let scale = E::of(1.0 / self.neighbours.len() as f64);
        let span = |row: u32| row as usize * width..(row as usize + 1) * width;
        let parts: Vec<(f64, Vec<E>)> = self
            .chosen
            .par_chunks(PART)
            .zip(self.neighbours.par_chunks(PART * k))
            .map(|(chosen, neighbours)| {
                let (mut sum, mut gradient) = (0.0, vec![E::zero(); features.len()]);
                let mut ratio = vec![E::zero(); width]; // sum over k of ln p_j / p_k
                for (&j, neighbours) in chosen.iter().zip(neighbours.chunks_exact(k)) {
                    let (p_j, log_p_j) = (&p[span(j)], &log_p[span(j)]);
                    ratio.fill(E::zero());
                    for &other in neighbours {
                        let (p_k, log_p_k) = (&p[span(other)], &log_p[span(other)]);
                        let d = &mut gradient[span(other)];
                        for c in 0..width {
                            ratio[c] += log_p_j[c] - log_p_k[c];
                            d[c] += scale * (p_k[c] - p_j[c]);
                        }
                    }
                    let divergence: E = p_j.iter().zip(&ratio).map(|(&p, &r)| p * r).sum();
                    sum += divergence.wide();
                    let d = &mut gradient[span(j)];
                    for c in 0..width {
                        d[c] += scale * p_j[c] * (ratio[c] - divergence);
                    }
                }
                (sum, gradient)
            })
            .collect();
        let mut value = 0.0;
        for (sum, part) in parts {
            value += sum;
            gradient.iter_mut().zip(part).for_each(|(g, d)| *g += d);
        }
        (E::of(value) * scale, gradient)
    }
}

/// Backend side of [`neighbour_divergence`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait DivergenceBackend: Backend {
    /// The mean divergence `[1]` and its gradient `[N, D]`, see [`NeighbourPairs::value_and_gradient`].
    fn neighbour_divergence(
        features: FloatTensor<Self>,
        pairs: Arc<NeighbourPairs>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostKernels> DivergenceBackend for B {
    fn neighbour_divergence(
        features: FloatTensor<Self>,
        pairs: Arc<NeighbourPairs>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::neighbour_divergence::<Self>(features, &pairs)
    }
}

/// The same by the CPU's kernel, wherever the tensor lives.
pub(super) mod on_host {
    use super::*;

    pub fn neighbour_divergence<B: HostBackend>(
        features: FloatTensor<B>,
        pairs: &NeighbourPairs,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, [rows, width]) = (device_of::<B>(&features), features.shape().dims());
        real_kernel!(features, E => {
            let (value, gradient) = pairs.value_and_gradient::<E>(&B::values(features), width);
            (B::tensor::<E>(vec![value], &[1], &device), B::tensor::<E>(gradient, &[rows, width], &device))
        })
    }
}

impl<B: DivergenceBackend, C: CheckpointStrategy> DivergenceBackend for Autodiff<B, C> {
    fn neighbour_divergence(
        features: FloatTensor<Self>,
        pairs: Arc<NeighbourPairs>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        with_gradient_in_hand::<B, C>(features, |features| {
            B::neighbour_divergence(features, pairs)
        })
    }
}

/// Eq. 9 for one scale: the mean over all pairs of D_KL(softmax f_j || softmax f_k) as `[1]`, with gradient to
/// `features` `[N, D]`, fused features of the scale. No pairs: zero.
///
/// # Panics
/// If a row of `pairs` is not below N, or `features` are neither f32 nor f64.
pub fn neighbour_divergence(features: Tensor<2>, pairs: NeighbourPairs) -> Tensor<1> {
    let points = features.dims()[0];
    let known = pairs
        .chosen
        .iter()
        .chain(&pairs.neighbours)
        .all(|&r| (r as usize) < points);
    assert!(known, "neighbour_divergence: a row is not below {points}");
    let (value, _) = Dispatch::neighbour_divergence(features.into_dispatch(), Arc::new(pairs));
    Tensor::from_dispatch(value)
}

/// [`neighbour_divergence`] in plain tensors: the reference of its tests.
pub fn neighbour_divergence_plain(features: Tensor<2>, pairs: &NeighbourPairs) -> Tensor<1> {
    let [points, width] = features.dims();
    let (count, total) = (pairs.chosen.len(), pairs.neighbours.len());
    if total == 0 {
        return (features * 0.0).sum();
    }
    let k = total / count;
    let own = log_softmax(pick(features.clone(), &pairs.chosen, points), 1);
    let others =
        log_softmax(pick(features, &pairs.neighbours, points), 1).reshape([count, k, width]);
    // sum_k p_j (l_j - l_k) = p_j (K l_j - sum_k l_k)
    let others: Tensor<2> = others.sum_dim(1).reshape([count, width]);
    (own.clone().exp() * (own * k as f64 - others)).sum() * (1.0 / total as f64)
}

fn pick(features: Tensor<2>, rows: &[u32], columns: usize) -> Tensor<2> {
    sparse_apply(
        features,
        Arc::new(SparseMatrix::selection(rows.to_vec(), columns)),
    )
}
