//! Eq. 9: neighbours in 3D should have similar features.

use crate::ops::{SparseMatrix, sparse_apply};
use burn::tensor::Tensor;
use burn::tensor::activation::log_softmax;
use std::sync::Arc;

/// Sampled points and their neighbours, for Eq. 9.
#[derive(Clone, Debug)]
pub struct NeighbourPairs {
    /// The M sampled rows.
    pub chosen: Vec<u32>,
    /// The K neighbours of each, `[M, K]`.
    pub neighbours: Vec<u32>,
}

impl NeighbourPairs {
    /// The sampled rows with their neighbours in `table`, `[N, k]`.
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
}

/// Eq. 9 for one scale: the mean over all pairs of D_KL(softmax f_j || softmax f_k) as `[1]`, with gradient to
/// `features` `[N, D]`, the fused features of the scale. It is 0 without pairs.
///
/// # Panics
/// If a row of `pairs` is not below N.
pub fn neighbour_divergence(features: Tensor<2>, pairs: &NeighbourPairs) -> Tensor<1> {
    let count = pairs.chosen.len();
    let total = pairs.neighbours.len();
    if total == 0 {
        return (features * 0.0).sum();
    }
    let points = features.dims()[0];
    let log_p = log_softmax(features, 1);
    let chosen = SparseMatrix::selection(pairs.chosen.clone(), points);
    let own = sparse_apply(log_p.clone(), Arc::new(chosen));
    let neighbours = SparseMatrix::row_sums(pairs.neighbours.clone(), total / count, points);
    let others = sparse_apply(log_p, Arc::new(neighbours));
    // sum_k p_j (ln p_j - ln p_k) = p_j (K ln p_j - sum_k ln p_k)
    let divergence = own.clone().exp() * (own * (total / count) as f64 - others);
    divergence.sum() * (1.0 / total as f64)
}
