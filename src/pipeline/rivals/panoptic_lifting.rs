//! The losses of Panoptic Lifting (Siddiqui et al. 2023) on classes of Gaussians.

use super::super::segmentation_inputs::SegmentationInputs;
use super::super::train_decoder::{DecodedScores, IdentityModel, Logits, PerGaussian, Rendered};
use crate::backend::device::{read, upload};
use crate::config::Blend;
use crate::data::{Classes, LabelRuns, View, ViewCache, first_largest};
use crate::error::Result;
use crate::objects::Identities;
use crate::segmentation::loss::CoSegLoss;
use crate::segmentation::pixels::{constant, one_hot};
use burn::tensor::Tensor;

/// Weight of the segment consistency against the label loss.
const LAMBDA_SEGMENT: f64 = 1.2;
/// Share of the iterations before segment consistency begins.
const SEGMENTS_FROM: f64 = 0.6;
/// Keeps the logarithm of a blended probability finite.
const MIN_PROBABILITY: f64 = 1e-8;

/// Each Gaussian has class probabilities, which are blended. The loss is cross-entropy weighted by the segmenter's confidence, plus
/// consistency within 2D segments: every pixel of a segment learns the segment's mean class.
///
/// Confidence is the largest probability of a pixel in the scores of its labels, and 1 where labels have no scores. Differences
/// from the original: Gaussians replace the field, and hard labels replace probabilities averaged over test-time augmentation.
/// Segments are the connected parts of one class in a label map. All segments of a step take part instead of 32.
pub struct PanopticLifting<'a> {
    views: Vec<&'a View>,
    names: &'a Classes,
    labels: ViewCache<Segments>,
    segments_from: usize,
}

/// The raw labels of a view as segments.
struct Segments {
    /// Number of the segment of each pixel.
    numbers: Vec<u32>,
    /// Confidence of each pixel.
    confidence: Vec<f32>,
}

impl<'a> PanopticLifting<'a> {
    /// The losses on the labelled views of `inputs`.
    pub fn new(inputs: &SegmentationInputs<'a>) -> Self {
        let scene = inputs.scene;
        let views: Vec<_> = scene.labelled().collect();
        let iterations = inputs.config.segmentation.iterations as f64;
        Self {
            // Eight bytes a pixel: a hundredth of what the weights take.
            labels: ViewCache::new(views.len(), usize::MAX),
            views,
            names: &scene.classes,
            segments_from: (SEGMENTS_FROM * iterations).round() as usize,
        }
    }
}

impl Segments {
    fn of(view: &View, classes: &Classes) -> Result<Self> {
        let map = view.raw.as_ref().map(LabelRuns::map).unwrap_or_default();
        let mut confidence = vec![1.0; map.ids.len()];
        if let Some(scores) = &view.scores {
            let scores = scores.read(classes)?;
            let mut found = Vec::new();
            for (pixel, confidence) in confidence.iter_mut().enumerate() {
                scores.at(pixel % map.width, pixel / map.width, &mut found);
                *confidence = found.first().map_or(0.0, |&(_, p)| p);
            }
        }
        Ok(Self {
            numbers: map.region_numbers(),
            confidence,
        })
    }
}

/// For each pixel the class of the largest mean probability in its segment. `p` is `[P, classes]`, `segments` has the number of
/// each pixel's segment.
fn segment_classes(p: &[f32], classes: usize, segments: &[u32]) -> Vec<u16> {
    let mut sums = std::collections::HashMap::<u32, Vec<f32>>::new();
    for (row, segment) in p.chunks_exact(classes.max(1)).zip(segments) {
        let sum = sums.entry(*segment).or_insert_with(|| vec![0.0; classes]);
        sum.iter_mut().zip(row).for_each(|(sum, p)| *sum += p);
    }
    let class = |segment| first_largest(&sums[segment]).unwrap_or(0) as u16;
    segments.iter().map(class).collect()
}

/// The mean over pixels of -w ln p of `labels`, from log-probabilities `[P, C]` and weights `[P, 1]`.
fn weighted_cross_entropy(log_p: &Tensor<2>, labels: &[u16], weights: Tensor<2>) -> Tensor<1> {
    let of_labels = (log_p.clone() * one_hot(labels, log_p)).sum_dim(1);
    (of_labels * weights).sum() * (-1.0 / labels.len() as f64)
}

impl IdentityModel for PanopticLifting<'_> {
    type Module = Logits;

    fn decode(
        &mut self,
        logits: &Logits,
        _view: usize,
        visible: &[u32],
        _iteration: usize,
    ) -> Result<DecodedScores> {
        Ok(logits.of(visible).into())
    }

    fn loss(&mut self, _coseg: &CoSegLoss, rendered: Rendered) -> Result<Tensor<1>> {
        let view = self.views[rendered.view];
        let names = self.names;
        let labels = self.labels.get(rendered.view, || {
            let segments = Segments::of(view, names)?;
            let bytes = 8 * segments.numbers.len();
            Ok((segments, bytes))
        })?;
        let sample = rendered.sample;
        let p = rendered.scores.probabilities(&sample.pixels)?;
        let count = sample.pixels.len();
        let classes = names.len();
        let numbers = || sample.numbers.iter().map(|&pixel| pixel as usize);
        let confidence: Vec<f32> = numbers().map(|pixel| labels.confidence[pixel]).collect();
        let confidence = upload(confidence, [count, 1], &p.device().inner());
        let confidence = constant(confidence, &p.device());
        let log_p = (p.clone() + MIN_PROBABILITY).log();
        let loss = weighted_cross_entropy(&log_p, &sample.pixels.labels, confidence.clone());
        if rendered.iteration < self.segments_from {
            return Ok(loss);
        }
        let segments: Vec<u32> = numbers().map(|pixel| labels.numbers[pixel]).collect();
        let p = read("class probabilities of pixels", p.inner())?;
        let targets = segment_classes(&p, classes, &segments);
        let consistency = weighted_cross_entropy(&log_p, &targets, confidence);
        Ok(loss + consistency * LAMBDA_SEGMENT)
    }

    fn identities(&self, logits: Logits) -> Result<Identities> {
        PerGaussian(Blend::Probabilities).identities(logits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[cfg(feature = "ndarray")]
    use burn::tensor::Device;

    #[test]
    fn a_segment_takes_its_largest_mean_class() {
        let p = [0.9, 0.1, 0.4, 0.6, 0.4, 0.6, 0.1, 0.9];
        assert_eq!(segment_classes(&p, 2, &[7, 7, 7, 3]), [0, 0, 0, 1]);
    }

    #[cfg(feature = "ndarray")]
    #[test]
    fn cross_entropy_is_weighted_by_confidence() {
        let device = Device::ndarray();
        let p = [[0.5_f32, 0.25, 0.25], [0.1, 0.8, 0.1]];
        let log_p = Tensor::<2>::from_data(p, &device).log();
        let weights = Tensor::<2>::from_data([[1.0_f32], [0.5]], &device);
        let loss = weighted_cross_entropy(&log_p, &[1, 1], weights).into_scalar::<f32>();
        let expected = -(0.25_f32.ln() + 0.5 * 0.8_f32.ln()) / 2.0;
        assert!((loss - expected).abs() < 1e-6, "{loss} {expected}");
    }
}
