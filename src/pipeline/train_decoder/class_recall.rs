//! How well a model follows the labels of each class, and how robust the loss of that class may be.
//!
//! Robust losses have small gradients where the model finds a label unlikely. That rejects wrong labels. But a class whose
//! labels the model never learned is then rejected as a whole, and its gradient vanishes. A class whose mean probability of
//! its own labels is low therefore learns by generalised cross-entropy with a smaller exponent, closer to cross-entropy the
//! lower that mean is. (A hard switch between two losses oscillates and disturbs neighbouring classes.)

use crate::backend::device::read;
use crate::error::Result;
use crate::ranks;
use crate::segmentation::loss::Scores;
use crate::segmentation::pixels::{LabelledPixels, NO_CLASS};

/// Steps between two measurements.
const INTERVAL: usize = 5;
/// Pixels of a class in a measurement, at most.
const PIXELS: usize = 256;
/// Number of pixels that would replace the running mean, were there no [`MAX_SHARE`].
const MEMORY_PIXELS: f64 = 500.0;
/// Largest share of a measurement in the running mean.
const MAX_SHARE: f64 = 0.2;

/// Running means of the probability that a model gives to the label of a pixel, by class.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassRecall(pub Vec<f64>);

impl ClassRecall {
    /// The state before any measurement: full recall.
    pub fn new(classes: usize) -> Self {
        Self(vec![1.0; classes])
    }

    /// The share of its robustness that a loss keeps for each class: all of it from a recall of `least` on.
    pub fn robustness(&self, least: f64) -> Vec<f64> {
        let share = |recall: &f64| (recall / least).min(1.0);
        self.0.iter().map(share).collect()
    }

    /// Measures `scores` of `pixels` at every fifth iteration.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`] and of reading from the device.
    pub fn measure(
        &self,
        scores: &Scores,
        pixels: &LabelledPixels,
        iteration: usize,
    ) -> Result<Measurement> {
        let classes = self.0.len();
        let mut measured = Measurement::none(classes);
        if !iteration.is_multiple_of(INTERVAL) {
            return Ok(measured);
        }
        let chosen = some_of_each(&pixels.labels, classes);
        if chosen.is_empty() {
            return Ok(measured);
        }
        let chosen_pixels = pixels.at(&chosen);
        let probabilities = scores.at(&chosen).probabilities(&chosen_pixels)?;
        let probabilities = read("class probabilities of pixels", probabilities)?;
        let rows = probabilities.chunks_exact(classes);
        for (row, &label) in rows.zip(chosen_pixels.labels.iter()) {
            let label = usize::from(label);
            measured.sums[label] += f64::from(row[label]);
            measured.counts[label] += 1.0;
        }
        Ok(measured)
    }

    /// The means with what was `measured` after them.
    pub fn after(&self, measured: &Measurement) -> Self {
        let measured = measured.sums.iter().zip(&measured.counts);
        let recalls = self.0.iter().zip(measured).map(|(&recall, (sum, count))| {
            if *count > 0.0 && sum.is_finite() {
                recall + (count / MEMORY_PIXELS).min(MAX_SHARE) * (sum / count - recall)
            } else {
                recall
            }
        });
        Self(recalls.collect())
    }
}

/// Probabilities that a model gives to the labels of pixels, by class.
#[derive(Clone, Debug)]
pub struct Measurement {
    sums: Vec<f64>,
    counts: Vec<f64>,
}

impl Measurement {
    /// No pixels.
    pub fn none(classes: usize) -> Self {
        Self {
            sums: vec![0.0; classes],
            counts: vec![0.0; classes],
        }
    }

    /// Adds the pixels of `other`.
    pub fn add(&mut self, other: &Self) {
        let pairs = [
            (&mut self.sums, &other.sums),
            (&mut self.counts, &other.counts),
        ];
        for (sums, values) in pairs {
            sums.iter_mut()
                .zip(values)
                .for_each(|(sum, value)| *sum += value);
        }
    }

    /// Adds the pixels of the other ranks.
    pub fn sum_over_ranks(&mut self) {
        ranks::sum(&mut self.sums);
        ranks::sum(&mut self.counts);
    }
}

/// Positions of up to [`PIXELS`] pixels of each class, evenly spread over its own.
fn some_of_each(labels: &[u16], classes: usize) -> Vec<u32> {
    let mut of_class: Vec<Vec<u32>> = vec![Vec::new(); classes];
    for (place, &label) in (0..).zip(labels).filter(|(_, label)| **label != NO_CLASS) {
        of_class[usize::from(label)].push(place);
    }
    let mut chosen = Vec::new();
    for places in of_class {
        let count = places.len().min(PIXELS);
        chosen.extend((0..count).map(|i| places[i * places.len() / count]));
    }
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::SparseMatrix;
    use crate::segmentation::pixels::PixelWeights;
    use burn::tensor::Tensor;
    use std::sync::Arc;

    #[test]
    fn pixels_are_spread_over_each_class() {
        let labels: Vec<u16> = (0..3000)
            .map(|i| {
                if i % 3 == 0 {
                    NO_CLASS
                } else {
                    u16::from(i >= 2990)
                }
            })
            .collect();
        let chosen = some_of_each(&labels, 3);
        let count = |class| {
            chosen
                .iter()
                .filter(|&&place| labels[place as usize] == class)
                .count()
        };
        assert_eq!((count(0), count(1), count(NO_CLASS)), (PIXELS, 7, 0));
        assert!(
            chosen.is_sorted() && chosen[0] < 10 && chosen[PIXELS - 1] > 2900,
            "{chosen:?}"
        );
        assert!(some_of_each(&[NO_CLASS; 4], 2).is_empty());
    }

    #[test]
    fn a_class_whose_labels_are_not_followed_falls_below_and_rises_again() {
        let device = crate::backend::device::open(None).unwrap();
        let pixels = LabelledPixels::new(
            PixelWeights::Stored(Arc::new(SparseMatrix::new(
                1,
                (0..=40).collect(),
                vec![0; 40],
                vec![1.0; 40],
            ))),
            (0..40).map(|i| if i < 20 { 0 } else { 2 }).collect(),
        );
        let mut recall = ClassRecall::new(3);
        let mut learn = |logits: [f32; 3], steps: usize| {
            // Logits of the one Gaussian behind all pixels.
            let scores = Scores::Gaussians(Tensor::<2>::from_data([logits], &device));
            (0..steps)
                .for_each(|i| recall = recall.after(&recall.measure(&scores, &pixels, i).unwrap()));
            (
                recall
                    .robustness(0.3)
                    .iter()
                    .map(|&share| share < 1.0)
                    .collect::<Vec<_>>(),
                recall.0.clone(),
            )
        };
        let (below, values) = learn([5.0, 0.0, -5.0], 300);
        assert_eq!(below, [false, false, true], "{values:?}");
        // No label says class 1: nothing is known of it.
        assert_eq!(values[1], 1.0);
        let (below, values) = learn([0.0, -9.0, 5.0], 150);
        assert_eq!(below, [true, false, false], "{values:?}");
    }
}
