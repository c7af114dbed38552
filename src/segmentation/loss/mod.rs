//! The CoSeg loss (Eq. 8 to 10): a noise-robust label loss on rendered class scores, and closeness of neighbours in 3D.

mod label_loss;
mod regularisation;

pub use self::label_loss::LabelLoss;
pub use self::regularisation::{NeighbourPairs, neighbour_divergence};

use self::label_loss::{MIN_PROBABILITY, OwnClass, exponents, generalised_cross_entropy};
use super::pixels::{LabelledPixels, NO_CLASS, constant};
use crate::error::Result;
use crate::ops::select;
use crate::splat::rows_where;
use burn::tensor::activation::{log_softmax, softmax};
use burn::tensor::{Tensor, TensorData};

/// Class scores, before or after blending.
#[derive(Clone, Debug)]
pub enum Scores {
    /// Of pixels: blended logits over 1 - T, `[P, C]`.
    Pixels(Tensor<2>),
    /// Of the view's visible Gaussians, `[V, C]`: their class probabilities are blended.
    Gaussians(Tensor<2>),
}

impl Scores {
    /// The scores of the pixels at `places`, without gradient.
    #[must_use]
    pub(crate) fn at(&self, places: &[u32]) -> Self {
        match self {
            Self::Pixels(logits) => Self::Pixels(select(&logits.clone().detach(), places)),
            Self::Gaussians(scores) => Self::Gaussians(scores.clone().detach()),
        }
    }

    /// Class probabilities of `pixels`, `[P, C]`.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn probabilities(self, pixels: &LabelledPixels) -> Result<Tensor<2>> {
        Ok(match self {
            Self::Pixels(logits) => softmax(logits, 1),
            Self::Gaussians(scores) => pixels.blend(softmax(scores, 1))?,
        })
    }
}

/// The loss of stage two (Eq. 10).
#[derive(Clone, Debug, PartialEq)]
pub struct CoSegLoss {
    /// The label loss.
    pub label: LabelLoss,
    /// Weights of the label loss and of the 3D regularisation.
    pub lambda: [f64; 2],
    /// Shares of the exponent of [`LabelLoss::Gce`] that pixels of each class keep, in 0..1: at 0 they learn by
    /// cross-entropy. Classes beyond the end keep all of it. A pixel with a distribution has the exponent of each of its classes.
    pub robustness: Vec<f64>,
}

impl From<LabelLoss> for CoSegLoss {
    /// The label loss alone.
    fn from(label: LabelLoss) -> Self {
        Self {
            label,
            lambda: [1.0, 0.0],
            robustness: Vec::new(),
        }
    }
}

impl CoSegLoss {
    /// Eq. 10, `[1]`: the mean label loss of `pixels` and the `regularisation`, if any, by their weights.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn forward(
        &self,
        scores: Scores,
        pixels: &LabelledPixels,
        regularisation: Option<Tensor<1>>,
    ) -> Result<Tensor<1>> {
        let label = self.of_scores(scores, pixels)? * self.lambda[0];
        Ok(match regularisation {
            Some(regularisation) => label + regularisation * self.lambda[1],
            None => label,
        })
    }

    /// Eq. 8: the mean label loss `[1]` of `pixels`; 0 without a labelled pixel.
    fn of_scores(&self, scores: Scores, pixels: &LabelledPixels) -> Result<Tensor<1>> {
        if pixels.distributions.is_some() {
            return self.of_distributions(scores, pixels);
        }
        Ok(match scores {
            Scores::Pixels(logits) => self.of_logits(logits, &pixels.labels),
            Scores::Gaussians(scores) => {
                let pixels = pixels.labelled();
                let classes = scores.dims()[1];
                assert_labels(&pixels.labels, pixels.len(), classes);
                if pixels.is_empty() {
                    return Ok((scores * 0.0).sum());
                }
                let p = pixels.blend_own_class(softmax(scores, 1))?;
                self.mean(OwnClass::of_probabilities(p, classes), &pixels.labels)
            }
        })
    }

    /// The mean label loss `[1]` of pixels with distributions; 0 without any.
    fn of_distributions(&self, scores: Scores, pixels: &LabelledPixels) -> Result<Tensor<1>> {
        let y = pixels.distributions.clone().expect("distributions");
        let log_p = match scores {
            Scores::Pixels(logits) => log_softmax(logits, 1),
            Scores::Gaussians(_) => (scores.probabilities(pixels)? + MIN_PROBABILITY).log(),
        };
        if pixels.is_empty() {
            return Ok((log_p * 0.0).sum());
        }
        let y = constant(y, &log_p.device());
        let losses = self.label.of_distributions(log_p, y, &self.robustness);
        Ok(losses.sum() * (1.0 / pixels.len() as f64))
    }

    /// The mean label loss `[1]` over the labelled rows of `logits` `[P, C]`, with gradient to `logits`; 0 without any.
    ///
    /// # Panics
    /// If there is not one label for each row, or a label is neither below C nor [`NO_CLASS`].
    pub fn of_logits(&self, logits: Tensor<2>, labels: &[u16]) -> Tensor<1> {
        let [rows, classes] = logits.dims();
        assert_labels(labels, rows, classes);
        let kept = rows_where(labels, |label| *label != NO_CLASS);
        if kept.is_empty() {
            return (logits * 0.0).sum();
        }
        if kept.len() == rows {
            return self.mean(OwnClass::of_logits(logits, labels), labels);
        }
        let labels: Vec<u16> = kept.iter().map(|&i| labels[i as usize]).collect();
        let own = OwnClass::of_logits(select(&logits, &kept), &labels);
        self.mean(own, &labels)
    }

    /// The mean loss of labelled pixels.
    fn mean(&self, own: OwnClass, labels: &[u16]) -> Tensor<1> {
        let losses = match self.exponents(labels) {
            Some(q) => generalised_cross_entropy(own.log_p, TensorData::new(q, [labels.len(), 1])),
            None => self.label.of_pixels(own),
        };
        losses.sum() * (1.0 / labels.len() as f64)
    }

    /// The exponent of each pixel, where [`CoSegLoss::robustness`] softens [`LabelLoss::Gce`].
    fn exponents(&self, labels: &[u16]) -> Option<Vec<f32>> {
        let LabelLoss::Gce { q } = self.label else {
            return None;
        };
        if self.robustness.iter().all(|&share| share >= 1.0) {
            return None;
        }
        let classes = labels.iter().map(|&label| usize::from(label));
        Some(exponents(q, &self.robustness, classes))
    }
}

fn assert_labels(labels: &[u16], rows: usize, classes: usize) {
    assert_eq!(labels.len(), rows, "label loss: labels against pixels");
    let known = |&label: &u16| label == NO_CLASS || usize::from(label) < classes;
    assert!(
        labels.iter().all(known),
        "label loss: a label is not a class index below {classes}"
    );
}
