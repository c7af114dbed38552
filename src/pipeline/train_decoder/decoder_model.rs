//! The decoder variants: multi-scale fusion (Eq. 7) trained by the label loss and the 3D regularisation (Eq. 10).
//!
//! A step decodes only what the view's visible Gaussians depend on. Views that show more than `segmentation.decoder_chunk`
//! are decoded in parts, so that the memory of the decoder's layers does not grow with the scene. The label loss reaches the
//! decoder through the scores `s` of the visible Gaussians alone. So each part is decoded without autodiff, the loss gives
//! `dL/ds` once, and then each part is decoded again with autodiff and its backward pass starts from its rows of `dL/ds`:
//! `dL/dtheta = sum_parts (ds_part/dtheta)^T dL/ds_part`. Recomputing instead of keeping is the trade of Chen et al. 2016
//! (Training deep nets with sublinear memory cost). Points of coarse scales that several parts depend on are decoded in each.

use super::adam::parameter_gradients;
use super::view_input::{DecoderInput, Encoded, REGULARISED, ViewInput};
use super::{DecodedScores, IdentityModel};
use crate::backend::device::{read, upload};
use crate::config::{Blend, SegmentationConfig};
use crate::error::Result;
use crate::objects::Identities;
use crate::ops::{SparseMatrix, selected};
use crate::segmentation::decoder::Decoder;
use crate::segmentation::pixels::constant;
use crate::segmentation::pyramid::Dependencies;
use burn::module::Module;
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Gradients, Tensor};
use std::sync::Arc;

/// Gaussians decoded at once when the stored identities are made.
const CHUNK: usize = 16_384;

/// How a decoder variant is trained.
#[derive(Clone, Copy, Debug)]
pub struct DecoderPlan<'a> {
    /// Settings of stage two.
    pub config: &'a SegmentationConfig,
    /// Whether Eq. 9 is part of the loss.
    pub regularised: bool,
    /// Number of Gaussians and of classes.
    pub size: [usize; 2],
    /// Seed of the regularisation's samples.
    pub seed: u64,
}

/// Scores in the form that identities store.
pub(super) fn stored_scores(scores: Tensor<2>, blend: Blend) -> Tensor<2> {
    match blend {
        Blend::Logits => scores,
        Blend::Probabilities => softmax(scores, 1),
    }
}

/// A view that was decoded in parts. Its scores are leaves of the loss's graph and wait for their gradient.
pub struct DecodedParts(ViewInput);

/// The frozen input of a decoder in training.
pub struct DecoderModel<'a> {
    /// Added to the scores of each Gaussian, `[N, C]`, without autodiff.
    prior: Option<Tensor<2>>,
    input: &'a DecoderInput,
    plan: DecoderPlan<'a>,
    /// Centres of all Gaussians.
    means: &'a [[f32; 3]],
}

impl<'a> DecoderModel<'a> {
    /// A model of a scene with Gaussians at `means`.
    pub fn new(input: &'a DecoderInput, means: &'a [[f32; 3]], plan: DecoderPlan<'a>) -> Self {
        Self {
            prior: None,
            input,
            plan,
            means,
        }
    }

    /// Adds `prior` `[N, C]` to the scores of every Gaussian, on `device`. Train it from `Decoder::with_silent_start`.
    ///
    /// # Panics
    /// If `prior` does not hold one score for each Gaussian and class.
    #[must_use]
    pub fn with_prior(mut self, prior: Vec<f32>, device: &Device) -> Self {
        let size = self.plan.size;
        assert_eq!(
            prior.len(),
            size[0] * size[1],
            "one prior score for each Gaussian and class"
        );
        self.prior = Some(upload(prior, size, &device.clone().inner()));
        self
    }

    /// Scores `[rows, C]` of `gaussians` of the scene, whose hidden features are the first rows of `hidden`.
    fn scores(
        &self,
        decoder: &Decoder,
        hidden: Tensor<2>,
        gaussians: &Arc<SparseMatrix>,
    ) -> Tensor<2> {
        let scores = first_rows(decoder.classify(hidden), gaussians.rows());
        match &self.prior {
            Some(prior) => {
                let prior = constant(selected(prior, gaussians), &scores.device());
                scores + prior
            }
            None => scores,
        }
    }

    /// Scores of the finest points, in chunks so that memory beside them does not grow with the scene.
    fn decode_all(&self, decoder: &Decoder, encoded: &Encoded) -> Result<Vec<f32>> {
        let count = encoded.points.len();
        let mut scores = Vec::with_capacity(count * self.plan.size[1]);
        for first in (0..count).step_by(CHUNK) {
            let rows = first..(first + CHUNK).min(count);
            let gaussians = encoded.points[rows.clone()].to_vec();
            let gaussians = Arc::new(SparseMatrix::selection(gaussians, self.plan.size[0]));
            let finest = rows.map(|row| row as u32).collect();
            let part = Dependencies::new(&encoded.pyramid, finest);
            let decoded = decoder.forward(&encoded.pyramid.part(&part));
            let part = self.scores(decoder, decoded.hidden, &gaussians);
            let part = stored_scores(part, self.plan.config.blend);
            scores.extend(read("identities", part)?);
        }
        Ok(scores)
    }

    /// s_i = sum_v w_iv s_iv / sum_v w_iv over the encodings of views, and the whole-scene encoding where no view sees i.
    fn mean_over_views(
        &self,
        decoder: &Decoder,
        views: &[Encoded],
        weights: &[Vec<f32>],
        scene: &Encoded,
    ) -> Result<Vec<f32>> {
        let [count, classes] = self.plan.size;
        let mut sums = vec![0.0_f32; count * classes];
        let mut totals = vec![0.0_f32; count];
        for (view, weights) in views.iter().zip(weights) {
            let decoded = self.decode_all(decoder, view)?;
            let rows = decoded.chunks_exact(classes.max(1)).zip(&view.points);
            for ((row, &i), &w) in rows.zip(weights) {
                totals[i as usize] += w;
                let sum = &mut sums[i as usize * classes..][..classes];
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += w * v);
            }
        }
        let whole = self.decode_all(decoder, scene)?;
        for (i, &total) in totals.iter().enumerate() {
            let span = i * classes..(i + 1) * classes;
            if total > 0.0 {
                sums[span].iter_mut().for_each(|s| *s /= total);
            } else {
                sums[span.clone()].copy_from_slice(&whole[span]);
            }
        }
        Ok(sums)
    }
}

/// `scores` without the rows that only fill a block.
fn first_rows(scores: Tensor<2>, count: usize) -> Tensor<2> {
    if scores.dims()[0] == count {
        return scores;
    }
    scores.narrow(0, 0, count)
}

impl IdentityModel for DecoderModel<'_> {
    type Module = Decoder;

    fn decode(
        &mut self,
        decoder: &Decoder,
        view: usize,
        visible: &[u32],
        iteration: usize,
    ) -> Result<DecodedScores> {
        let encoded = self.input.view(view);
        let input = ViewInput::new(encoded, visible, self.means, &self.plan)?;
        let pyramid = &encoded.pyramid;
        match &input.parts[..] {
            [part] => {
                let decoded = decoder.forward(&pyramid.part(&part.rows));
                Ok(DecodedScores {
                    scores: self.scores(decoder, decoded.hidden, &part.gaussians),
                    regularisation: input.regularisation(&decoded.fused, &self.plan, iteration),
                    parts: None,
                })
            }
            parts => {
                let frozen = decoder.valid();
                let scores = parts.iter().map(|part| {
                    let decoded = frozen.forward(&pyramid.part(&part.rows));
                    self.scores(&frozen, decoded.hidden, &part.gaussians)
                });
                let scores = Tensor::cat(scores.collect(), 0);
                let regularisation = input.coarse_rows(pyramid).and_then(|coarse| {
                    let fused = decoder.fuse(&pyramid.part(&coarse), REGULARISED.start);
                    input.regularisation(&fused, &self.plan, iteration)
                });
                Ok(DecodedScores {
                    scores: Tensor::from_inner(scores).require_grad(),
                    regularisation,
                    parts: Some(DecodedParts(input)),
                })
            }
        }
    }

    fn gradient(
        &self,
        decoder: &Decoder,
        view: usize,
        decoded: &DecodedScores,
        gradients: &mut Gradients,
    ) -> Tensor<1> {
        let mut sum = parameter_gradients(decoder, gradients);
        let Some(DecodedParts(input)) = &decoded.parts else {
            return sum;
        };
        let Some(gradient) = decoded.scores.grad_remove(gradients) else {
            return sum;
        };
        let pyramid = &self.input.view(view).pyramid;
        for part in &input.parts {
            let seed = Tensor::from_inner(gradient.clone().slice([part.places.clone()]));
            let hidden = decoder.forward(&pyramid.part(&part.rows)).hidden;
            let scores = first_rows(decoder.classify(hidden), part.places.len());
            let mut of_part = (scores * seed).sum().backward();
            sum = sum + parameter_gradients(decoder, &mut of_part);
        }
        sum
    }

    fn identities(&self, decoder: Decoder) -> Result<Identities> {
        let decoder = decoder.valid();
        let scores = match self.input {
            DecoderInput::Scene(scene) => self.decode_all(&decoder, scene)?,
            DecoderInput::Views {
                views,
                scene,
                weights,
            } => self.mean_over_views(&decoder, views, weights, scene)?,
        };
        let classes = self.plan.size[1];
        Ok(Identities { scores, classes })
    }
}
