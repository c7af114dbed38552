//! How far a model follows the labels of each class, and which classes a robust loss is about to give up.
//!
//! Robust losses turn away from labels that the model holds for unlikely. That is what they are for, but a class whose labels
//! the model never came to believe is turned away from as a whole, however right they are: its gradient dies, and with it
//! the class. Below a least mean probability of its own labels a class is therefore learnt by generalised cross-entropy with a
//! smaller exponent, the nearer to cross-entropy the less it is followed. (A switch from one loss to the other swings to and fro,
//! and takes neighbouring classes along.)

use super::Scores;
use crate::error::Result;
use crate::ops::{LabelledPixels, UNLABELLED};

/// Steps between two measurements.
const EVERY: usize = 5;
/// Pixels of a class that are looked at, at most.
const PIXELS: usize = 256;
/// Pixels that count as much as all before them, were there no [`FASTEST`].
const WEIGHT: f64 = 500.0;
/// Share of a measurement in the running mean, at most.
const FASTEST: f64 = 0.2;

/// Running means of the probability that a model gives to the label of a pixel, by class.
#[derive(Clone, Debug, PartialEq)]
pub struct Recalls(pub Vec<f64>);

impl Recalls {
    /// Before anything is known: nothing has been given up.
    pub fn new(classes: usize) -> Self {
        Self(vec![1.0; classes])
    }

    /// The part of its robustness that a loss keeps, by class: all of it from a recall of `least` on.
    pub fn shares(&self, least: f64) -> Vec<f64> {
        self.0
            .iter()
            .map(|&recall| (recall / least).min(1.0))
            .collect()
    }

    /// Takes up what `scores` say of `pixels`, at the iterations where that is done.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`] and of reading from the device.
    pub fn measure(
        &mut self,
        scores: &Scores,
        pixels: &LabelledPixels,
        iteration: usize,
    ) -> Result<()> {
        if !iteration.is_multiple_of(EVERY) {
            return Ok(());
        }
        let chosen = some_of_each(&pixels.labels, self.0.len());
        let labels: Vec<u16> = chosen
            .iter()
            .map(|&place| pixels.labels[place as usize])
            .collect();
        if chosen.is_empty() {
            return Ok(());
        }
        let probabilities = scores.probabilities_at(pixels, &chosen)?;
        let mut sums = vec![(0.0, 0.0); self.0.len()];
        for (row, &label) in probabilities.chunks_exact(self.0.len()).zip(&labels) {
            let (sum, count) = &mut sums[usize::from(label)];
            *sum += f64::from(row[usize::from(label)]);
            *count += 1.0;
        }
        for (recall, (sum, count)) in self
            .0
            .iter_mut()
            .zip(sums)
            .filter(|(_, (sum, count))| sum.is_finite() && *count > 0.0)
        {
            *recall += (count / WEIGHT).min(FASTEST) * (sum / count - *recall);
        }
        Ok(())
    }
}

/// Places of up to [`PIXELS`] pixels of each class, evenly spread over its own.
fn some_of_each(labels: &[u16], classes: usize) -> Vec<u32> {
    let mut of_class = vec![Vec::new(); classes];
    for (place, &label) in (0..).zip(labels).filter(|(_, label)| **label != UNLABELLED) {
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
    use burn::tensor::Tensor;

    #[test]
    fn pixels_are_spread_over_each_class() {
        let labels: Vec<u16> = (0..3000)
            .map(|i| {
                if i % 3 == 0 {
                    UNLABELLED
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
        assert_eq!((count(0), count(1), count(UNLABELLED)), (PIXELS, 7, 0));
        assert!(
            chosen.is_sorted() && chosen[0] < 10 && chosen[PIXELS - 1] > 2900,
            "{chosen:?}"
        );
        assert!(some_of_each(&[UNLABELLED; 4], 2).is_empty());
    }

    #[test]
    fn a_class_whose_labels_are_not_followed_falls_below_and_rises_again() {
        let device = crate::backend::device::open(None).unwrap();
        let pixels = LabelledPixels::new(
            crate::ops::PixelWeights::Stored(std::sync::Arc::new(crate::ops::SparseMatrix::new(
                1,
                (0..=40).collect(),
                vec![0; 40],
                vec![1.0; 40],
            ))),
            (0..40).collect(),
            (0..40).map(|i| if i < 20 { 0 } else { 2 }).collect(),
        );
        let mut recalls = Recalls::new(3);
        let mut learn = |logits: [f32; 3], steps: usize| {
            // Of the one Gaussian behind all pixels.
            let scores = Scores::Gaussians(Tensor::<2>::from_data([logits], &device));
            (0..steps).for_each(|i| recalls.measure(&scores, &pixels, i).unwrap());
            (
                recalls
                    .shares(0.3)
                    .iter()
                    .map(|&share| share < 1.0)
                    .collect::<Vec<_>>(),
                recalls.0.clone(),
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
