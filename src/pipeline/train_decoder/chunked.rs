//! A step over many Gaussians, of which the decoder's layers hold a part at a time: their memory does not grow with the scene;
//! that of the scores `[V, C]` of a view, of their probabilities and gradients does.
//!
//! The label loss reaches the decoder through the scores `s` of the visible Gaussians alone. So they are computed part by part
//! without autodiff, the loss gives `dL/ds` once, and then each part is decoded again with autodiff and its backward pass
//! started from its rows of `dL/ds`: `dL/dtheta = sum_parts (ds_part/dtheta)^T dL/ds_part`, with the activations of one part in
//! memory. Recomputing instead of keeping is the trade of Chen et al. 2016 (Training deep nets with sublinear memory cost).
//! Points of coarser scales that several parts depend on are decoded in each of them.

use super::optimiser;
use super::prepared::{Cloud, Prepared, REGULARISED, Sampled};
use crate::ops::sum_all;
use crate::segmentation::decoder::Decoder;
use crate::segmentation::loss::neighbour_divergence;
use crate::segmentation::pyramid::{Pyramid, Restriction, Rows};
use burn::tensor::{Gradients, Tensor};
use std::sync::Arc;

/// Scores that the loss was computed from, waiting for their gradient.
pub(crate) struct Waiting {
    /// The view.
    pub view: usize,
    /// Its parts.
    pub prepared: Arc<Prepared>,
    /// Of each prediction `[V, C]`, a leaf of the loss's graph, and the factors of the channels that it was made with.
    pub scores: Vec<(Tensor<2>, Vec<Vec<f32>>)>,
}

impl Waiting {
    /// Adds the gradients of the parameters of `decoder` to `gradients`, which hold that of the scores, part by part in order.
    pub fn add_gradients(&self, decoder: &Decoder, pyramid: &Pyramid, gradients: &mut Gradients) {
        for (scores, factors) in &self.scores {
            let Some(seed) = scores.grad_remove(gradients) else {
                continue;
            };
            for part in &self.prepared.parts {
                let seed = Tensor::from_inner(seed.clone().slice([part.rows.clone()]));
                let scores =
                    decoder.classify(decoder.forward_scaled(pyramid, &part.kept, factors).hidden);
                let mut of_part = sum_all(scores * seed).backward();
                optimiser::add_gradients(decoder, &mut of_part, gradients);
            }
        }
    }
}

/// Eq. 9 over the points that were sampled of each regularised scale, decoding these and their neighbours alone; nothing
/// where there are none. `factors` are those of the channels.
pub(crate) fn regularisation(
    decoder: &Decoder,
    pyramid: &Pyramid,
    factors: &[Vec<f32>],
    clouds: &[Cloud],
    sampled: Sampled,
) -> Option<Tensor<1>> {
    let mut wanted = vec![Rows::default(); pyramid.levels.len()];
    for ((scale, cloud), pairs) in REGULARISED.into_iter().zip(clouds).zip(&sampled) {
        let places = pairs
            .iter()
            .flat_map(|pairs| pairs.chosen.iter().chain(&pairs.neighbours));
        let mut rows: Vec<u32> = places.map(|&place| cloud.rows[place as usize]).collect();
        rows.sort_unstable();
        rows.dedup();
        if !rows.is_empty() {
            wanted[scale] = Arc::new(rows.into());
        }
    }
    let finest = wanted.iter().position(|rows| !rows.is_empty())?;
    let kept = Restriction::of_levels(pyramid, wanted);
    let fused = decoder.fused(pyramid, &kept, factors, finest);
    let terms =
        REGULARISED
            .into_iter()
            .zip(clouds)
            .zip(sampled)
            .filter_map(|((scale, cloud), pairs)| {
                let (mut pairs, rows) = (pairs?, kept.rows(scale)?);
                // Positions in the cloud become positions among the rows that were decoded, which hold all of these.
                for place in pairs.chosen.iter_mut().chain(&mut pairs.neighbours) {
                    *place = rows.partition_point(|&row| row < cloud.rows[*place as usize]) as u32;
                }
                Some(neighbour_divergence(
                    fused.get(scale - finest)?.clone(),
                    pairs,
                ))
            });
    terms.reduce(|sum, term| sum + term)
}
