//! A step over many Gaussians, of which the decoder's layers hold one part at a time. Their memory does not grow with the
//! scene; that of the scores `[V, C]` of a view does.
//!
//! The label loss reaches the decoder through the scores `s` of the visible Gaussians alone. So each part is decoded without
//! autodiff, the loss gives `dL/ds` once, and then each part is decoded again with autodiff and its backward pass starts
//! from its rows of `dL/ds`: `dL/dtheta = sum_parts (ds_part/dtheta)^T dL/ds_part`. Recomputing instead of keeping is the
//! trade of Chen et al. 2016 (Training deep nets with sublinear memory cost). Points of coarse scales that several parts
//! depend on are decoded in each of them.

use super::decoder_model::input;
use super::optimiser;
use super::view_input::{Cloud, REGULARISED, ViewInput};
use crate::segmentation::decoder::Decoder;
use crate::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use crate::segmentation::pyramid::{Dependencies, Pyramid};
use burn::tensor::{Gradients, Tensor};
use std::sync::Arc;

/// Scores that the loss was computed from. They wait for their gradient.
pub(super) struct PendingScores {
    /// The view.
    pub view: usize,
    /// Its parts.
    pub input: Arc<ViewInput>,
    /// For each prediction `[V, C]`, a leaf of the loss's graph, and the factors of its channels.
    pub scores: Vec<(Tensor<2>, Vec<Vec<f32>>)>,
}

impl PendingScores {
    /// Adds the gradients of the parameters of `decoder` to `gradients`, which hold that of the scores, part by part.
    pub fn add_gradients(&self, decoder: &Decoder, pyramid: &Pyramid, gradients: &mut Gradients) {
        for (scores, factors) in &self.scores {
            let Some(gradient) = scores.grad_remove(gradients) else {
                continue;
            };
            for part in &self.input.parts {
                let seed = Tensor::from_inner(gradient.clone().slice([part.places.clone()]));
                let decoded = decoder.forward(&input(part, pyramid, factors));
                let scores = decoder.classify(decoded.hidden);
                let mut of_part = (scores * seed).sum().backward();
                optimiser::add_gradients(decoder, &mut of_part, gradients);
            }
        }
    }
}

/// Eq. 9 over the sampled points of each regularised scale, none without any. Only these points and their neighbours are
/// decoded. `factors` are those of the channels.
pub(super) fn regularisation(
    decoder: &Decoder,
    pyramid: &Pyramid,
    factors: &[Vec<f32>],
    clouds: &[Cloud],
    samples: Vec<Option<NeighbourPairs>>,
) -> Option<Tensor<1>> {
    let mut wanted = vec![Vec::new(); pyramid.levels.len()];
    for ((scale, cloud), pairs) in REGULARISED.into_iter().zip(clouds).zip(&samples) {
        if let Some(pairs) = pairs {
            let places = pairs.chosen.iter().chain(&pairs.neighbours);
            wanted[scale] = places.map(|&place| cloud.rows[place as usize]).collect();
            wanted[scale].sort_unstable();
            wanted[scale].dedup();
        }
    }
    let finest = wanted.iter().position(|rows| !rows.is_empty())?;
    let rows = Dependencies::of_levels(pyramid, wanted);
    let fused = decoder.fuse(&pyramid.part(&rows).scaled(factors), finest);
    let scales = REGULARISED.into_iter().zip(clouds).zip(samples);
    let terms = scales.filter_map(|((scale, cloud), pairs)| {
        let mut pairs = pairs?;
        // Places in the cloud become places among the rows that were decoded, which hold all of these.
        for place in pairs.chosen.iter_mut().chain(&mut pairs.neighbours) {
            let wanted = cloud.rows[*place as usize];
            *place = rows.rows(scale).partition_point(|&row| row < wanted) as u32;
        }
        Some(neighbour_divergence(
            fused.get(scale - finest)?.clone(),
            &pairs,
        ))
    });
    terms.reduce(|sum, term| sum + term)
}
