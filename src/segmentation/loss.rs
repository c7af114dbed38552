//! The CoSeg loss (Eq. 8 to 10): a noise-robust label loss on rendered class scores, and closeness of neighbours in 3D.

use super::pixels::{LabelledPixels, UNLABELLED, one_hot};
use crate::config::{self, SegmentationConfig};
use crate::error::Result;
use crate::ops::{SparseMatrix, select, sparse_apply};
use burn::tensor::activation::{log_softmax, softmax};
use burn::tensor::{Tensor, TensorData};
use std::sync::Arc;

/// Keeps the logarithm of a blended probability finite.
const LEAST_PROBABILITY: f64 = 1e-8;
/// Logarithm of a label's zeros in [`LabelLoss::NceRce`] (Ma et al. 2020).
const LOG_ZERO: f64 = -4.0;
/// Weight of the raw label in [`LabelLoss::Gjs`] of the settings.
const GJS_PI: f64 = 0.99;
/// Least exponent of a softened [`LabelLoss::Gce`]: within a thousandth of cross-entropy for probabilities above 1e-5.
const SOFTEST: f64 = 1e-4;

/// A loss between the class probabilities p of a pixel and its label y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LabelLoss {
    /// Cross-entropy, -ln p_y.
    Ce,
    /// Generalised cross-entropy, (1 - p_y^q) / q (Zhang and Sabuncu 2018).
    Gce {
        /// The exponent, in (0, 1].
        q: f64,
    },
    /// Jensen-Shannon (Eq. 8), divided by Z = -(1 - pi) ln(1 - pi). It tends to [`LabelLoss::Ce`] for `pi` to 0 and to
    /// [`LabelLoss::Mae`] for `pi` to 1.
    Js {
        /// Weight of the raw label, in (0, 1).
        pi: f64,
    },
    /// Half the absolute error of the distribution, 1 - p_y.
    Mae,
    /// Normalised cross-entropy ln p_y / sum_k ln p_k plus reverse cross-entropy 4 (1 - p_y) (Ma et al. 2020, with
    /// alpha = beta = 1).
    NceRce,
    /// Generalised Jensen-Shannon between the label and two predictions (Englesson and Azizpour 2021).
    Gjs {
        /// Weight of the raw label, in (0, 1).
        pi: f64,
    },
}

impl LabelLoss {
    /// The loss that the settings ask for after the warm-up.
    ///
    /// # Errors
    /// [`crate::Error::Config`] when a payload of the loss is out of range.
    pub fn from_config(config: &SegmentationConfig) -> Result<Self> {
        config.loss.check()?;
        Ok(match config.loss {
            config::LabelLoss::Ce => Self::Ce,
            config::LabelLoss::Gce { exponent: q, .. } => Self::Gce { q },
            config::LabelLoss::Mae => Self::Mae,
            config::LabelLoss::NceRce => Self::NceRce,
            config::LabelLoss::Js { pi_rl: pi } => Self::Js { pi },
            config::LabelLoss::Gjs => Self::Gjs { pi: GJS_PI },
        })
    }

    /// Losses `[P, 1]` of pixels.
    fn of_pixels(self, own: OwnClass) -> Tensor<2> {
        match self {
            Self::Ce => own.log_p.neg(),
            Self::Mae => own.rest,
            Self::NceRce => match own.sum_of_logs {
                Some(sum) => own.log_p / sum + own.rest * -LOG_ZERO,
                None => own.rest * -LOG_ZERO,
            },
            Self::Gce { q } => {
                let q = Tensor::from_data([[q]], (&own.log_p.device(), own.log_p.dtype()));
                generalised_cross_entropy(own.log_p, q)
            }
            Self::Js { pi } | Self::Gjs { pi } => jensen_shannon(own, pi),
        }
    }
}

/// (1 - p^q) / q for exponents `q`, `[P, 1]` or `[1, 1]`. Near p = 1 the difference 1 - exp(x) would lose its digits: there it
/// is 2 t / (1 + t) with t = tanh(-x / 2), by the continued fraction of tanh, which is plain arithmetic on every device.
fn generalised_cross_entropy(log_p: Tensor<2>, q: Tensor<2>) -> Tensor<2> {
    let x = log_p * q.clone();
    let half = (x.clone() * -0.5).clamp_max(1.0);
    let square = half.clone() * half.clone();
    let numerator = (square.clone() + 105.0) * square.clone() + 945.0;
    let denominator = (square.clone() * 15.0 + 420.0) * square + 945.0;
    let tanh = half * numerator / denominator;
    let near = tanh.clone() * 2.0 / (tanh + 1.0);
    let far = x.clone().exp().neg() + 1.0;
    far.mask_where(x.greater_elem(-0.5), near) * q.recip()
}

/// ln(1 + x) for x > -1. Near 0 it is 2 artanh(x / (2 + x)) by its series: GPUs round 1 + x before they take the logarithm.
fn log1p(x: Tensor<2>) -> Tensor<2> {
    const NEAR: f64 = 0.125;
    let near = x.clone().clamp(-NEAR, NEAR);
    let z = near.clone() / (near + 2.0);
    let square = z.clone() * z.clone();
    let mut series = square.clone() * (1.0 / 13.0) + 1.0 / 11.0;
    for divisor in [9.0, 7.0, 5.0, 3.0, 1.0] {
        series = series * square.clone() + 1.0 / divisor;
    }
    let is_near = x.clone().abs().lower_elem(NEAR);
    (x + 1.0).log().mask_where(is_near, z * series * 2.0)
}

/// Eq. 8 over Z, in closed form. With m = pi + (1 - pi) p_y the divergence to the label is -ln m; that to the prediction
/// is p_y ln(p_y / m) - (1 - p_y) ln(1 - pi).
fn jensen_shannon(own: OwnClass, pi: f64) -> Tensor<2> {
    let OwnClass { log_p, p, rest, .. } = own;
    let log_rest_weight = (-pi).ln_1p(); // ln(1 - pi)
    // m = 1 - (1 - pi) (1 - p): take the logarithm from the end that keeps its digits.
    let missing = rest.clone() * (1.0 - pi);
    let log_m = (p.clone() * (1.0 - pi) + pi).log().mask_where(
        missing.clone().lower_elem(0.5),
        log1p(missing.clamp_max(0.5).neg()),
    );
    // ln(m / p) = ln(1 + pi (1 - p) / p): likewise. The divisor keeps the branch that is not taken finite.
    let excess = rest.clone() * pi;
    let divisor = p.clone().max_pair(excess.clone());
    let log_m_over_p = (log_m.clone() - log_p)
        .mask_where(excess.clone().lower(p.clone()), log1p(excess / divisor));
    let prediction = rest * -log_rest_weight - p * log_m_over_p;
    let z = -(1.0 - pi) * log_rest_weight;
    log_m * (-pi / z) + prediction * ((1.0 - pi) / z)
}

/// What the losses read of a pixel's class probabilities, `[P, 1]` each.
struct OwnClass {
    /// ln p_y.
    log_p: Tensor<2>,
    /// p_y.
    p: Tensor<2>,
    /// 1 - p_y.
    rest: Tensor<2>,
    /// sum_k ln p_k; none for a single class, or where only p_y is known.
    sum_of_logs: Option<Tensor<2>>,
}

impl OwnClass {
    /// From `logits` `[P, C]` of labelled pixels: softmax over the margins z_k - z_y, whose sum without the label's own
    /// term keeps the digits of 1 - p_y. The shift is a constant that cancels.
    fn of_logits(logits: Tensor<2>, labels: &[u16]) -> Self {
        let classes = logits.dims()[1];
        let own = one_hot(labels, &logits);
        let margins = logits.clone() - (logits * own.clone()).sum_dim(1);
        let shift = margins.clone().detach().max_dim(1);
        let own_power = shift.clone().neg().exp();
        let others = ((margins.clone() - shift.clone()).exp() * (own.neg() + 1.0)).sum_dim(1);
        let total = others.clone() + own_power.clone();
        let log_p = (log1p(others.clone() + (own_power.clone() - 1.0)) + shift).neg();
        let sum_of_logs =
            (classes > 1).then(|| margins.sum_dim(1) + log_p.clone() * classes as f64);
        let p = own_power / total.clone();
        // Each form keeps the digits of values and gradients where the other cancels.
        let rest = (others / total).mask_where(p.clone().lower_elem(0.5), p.clone().neg() + 1.0);
        Self {
            log_p,
            p,
            rest,
            sum_of_logs,
        }
    }

    /// From blended probabilities `[P, 1]` of the labelled classes.
    fn of_probabilities(p: Tensor<2>, classes: usize) -> Self {
        let total = 1.0 + classes as f64 * LEAST_PROBABILITY;
        let p = ((p + LEAST_PROBABILITY) * total.recip()).clamp_max(1.0);
        Self {
            log_p: p.clone().log(),
            rest: p.clone().neg() + 1.0,
            p,
            sum_of_logs: None,
        }
    }
}

/// Class scores, before or after blending.
#[derive(Clone, Debug)]
pub enum Scores {
    /// Of pixels: blended logits over 1 - T, `[P, C]`.
    Pixels(Tensor<2>),
    /// Of the view's visible Gaussians, `[V, C]`: their class probabilities are blended.
    Gaussians(Tensor<2>),
    /// Two predictions from different parts of the input, each one of the above.
    Pair(Box<[Scores; 2]>),
}

impl Scores {
    /// The first prediction for the pixels at `places`, without gradient.
    #[must_use]
    pub(crate) fn at(&self, places: &[u32]) -> Self {
        match self {
            Self::Pixels(logits) => Self::Pixels(select(&logits.clone().detach(), places)),
            Self::Gaussians(scores) => Self::Gaussians(scores.clone().detach()),
            Self::Pair(pair) => pair[0].at(places),
        }
    }

    /// Class probabilities of `pixels`, `[P, C]`; of a pair their mean.
    ///
    /// # Errors
    /// Those of [`LabelledPixels::blend`].
    pub fn probabilities(self, pixels: &LabelledPixels) -> Result<Tensor<2>> {
        Ok(match self {
            Self::Pixels(logits) => softmax(logits, 1),
            Self::Gaussians(scores) => pixels.blend(softmax(scores, 1))?,
            Self::Pair(pair) => {
                let [a, b] = *pair;
                (a.probabilities(pixels)? + b.probabilities(pixels)?) * 0.5
            }
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
    /// cross-entropy. Classes beyond the end keep all of it.
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
        Ok(match scores {
            Scores::Pixels(logits) => self.of_logits(logits, &pixels.labels),
            Scores::Gaussians(scores) if self.label == LabelLoss::NceRce => {
                let blended = pixels.blend(softmax(scores, 1))?;
                // softmax(ln q) = q / sum q: the loss reads the mixture itself.
                self.of_logits((blended + LEAST_PROBABILITY).log(), &pixels.labels)
            }
            Scores::Gaussians(scores) => {
                let (pixels, classes) = (pixels.labelled(), scores.dims()[1]);
                assert_labels(&pixels.labels, pixels.len(), classes);
                if pixels.is_empty() {
                    return Ok((scores * 0.0).sum());
                }
                let p = pixels.blend_own_class(softmax(scores, 1))?;
                self.mean(OwnClass::of_probabilities(p, classes), &pixels.labels)
            }
            Scores::Pair(pair) => {
                let [a, b] = *pair;
                let pair = [a.probabilities(pixels)?, b.probabilities(pixels)?];
                self.of_pair(pair, &pixels.labels)
            }
        })
    }

    /// The mean label loss `[1]` over the labelled rows of `logits` `[P, C]`, with gradient to `logits`; 0 without any.
    ///
    /// # Panics
    /// If there is not one label for each row, or a label is neither below C nor [`UNLABELLED`].
    pub fn of_logits(&self, logits: Tensor<2>, labels: &[u16]) -> Tensor<1> {
        let [rows, classes] = logits.dims();
        assert_labels(labels, rows, classes);
        let kept: Vec<u32> = (0..rows as u32)
            .filter(|&i| labels[i as usize] != UNLABELLED)
            .collect();
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

    /// The mean over pixels of the label loss of the mean of two predictions, class probabilities `[P, C]`, and of their
    /// Jensen-Shannon divergence by [`LabelLoss::Gjs`].
    ///
    /// This is the loss of Englesson and Azizpour (2021) for M = 3 and weights pi, (1 - pi) / 2, (1 - pi) / 2, by its
    /// decomposition (their proposition 2), divided by Z = -(1 - pi) ln(1 - pi).
    ///
    /// # Panics
    /// As [`CoSegLoss::of_logits`].
    pub fn of_pair(&self, [a, b]: [Tensor<2>; 2], labels: &[u16]) -> Tensor<1> {
        let mean = (a.clone() + b.clone()) * 0.5;
        let log_mean = (mean + LEAST_PROBABILITY).log();
        let loss = self.of_logits(log_mean.clone(), labels);
        let LabelLoss::Gjs { pi } = self.label else {
            return loss;
        };
        if labels.is_empty() {
            return loss;
        }
        let to_mean =
            |p: Tensor<2>| (p.clone() * ((p + LEAST_PROBABILITY).log() - log_mean.clone())).sum();
        let weight = -0.5 / ((-pi).ln_1p() * labels.len() as f64);
        loss + (to_mean(a) + to_mean(b)) * weight
    }

    /// The mean loss of labelled pixels.
    fn mean(&self, own: OwnClass, labels: &[u16]) -> Tensor<1> {
        let losses = match self.exponents(labels) {
            Some(q) => {
                let q = TensorData::new(q, [labels.len(), 1]);
                let options = (&own.log_p.device(), own.log_p.dtype());
                generalised_cross_entropy(own.log_p, Tensor::from_data(q, options))
            }
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
        let share = |label: &u16| self.robustness.get(usize::from(*label)).map_or(1.0, |&s| s);
        let exponent = |label| (q * share(label)).max(SOFTEST.min(q)) as f32;
        Some(labels.iter().map(exponent).collect())
    }
}

fn assert_labels(labels: &[u16], rows: usize, classes: usize) {
    assert_eq!(labels.len(), rows, "label loss: labels against pixels");
    let known = |&label: &u16| label == UNLABELLED || usize::from(label) < classes;
    assert!(
        labels.iter().all(known),
        "label loss: a label is no class index below {classes}"
    );
}

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
    let (count, total) = (pairs.chosen.len(), pairs.neighbours.len());
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
