//! Generalised Jensen-Shannon loss: one label, two predictions from different parts of the input.

use crate::ops::{Kind, label_loss, sum_all};
use crate::random::{Purpose, stream};
use crate::segmentation::pyramid::Pyramid;
use burn::tensor::Tensor;
use rand::Rng;

/// Keeps the logarithm of a probability finite.
const LEAST_PROBABILITY: f64 = 1e-8;

/// Factors of the frozen channels of every scale for prediction `index` of a run with `seed`: 0 for a random `rate` of
/// them, the others 1 / (1 - rate).
pub fn dropped_channels(pyramid: &Pyramid, rate: f64, seed: u64, index: usize) -> Vec<Vec<f32>> {
    let mut rng = stream(seed, Purpose::Dropout, index as u64);
    let kept = (1.0 - rate).recip() as f32;
    let mut factors = |channels: usize| {
        (0..channels)
            .map(|_| if rng.random_bool(rate) { 0.0 } else { kept })
            .collect()
    };
    pyramid
        .levels
        .iter()
        .map(|level| factors(level.features.dims()[1]))
        .collect()
}

/// Mean over pixels of `kind` between `labels` and the mean of two predictions, and of `weight` times the Jensen-Shannon
/// divergence of these. The predictions are class probabilities, `[P, C]`.
///
/// With [`Kind::Js`] and the weight -1 / ln(1 - pi_rl) this is the loss of Englesson and Azizpour (2021), *Generalized
/// Jensen-Shannon Divergence Loss for Learning with Noisy Labels*, for M = 3 and weights pi_rl, (1 - pi_rl) / 2,
/// (1 - pi_rl) / 2, by its decomposition (their proposition 2), divided by Z = -(1 - pi_rl) ln(1 - pi_rl).
///
/// # Panics
/// As [`label_loss`].
pub fn generalised_js(
    [a, b]: [Tensor<2>; 2],
    labels: &[u16],
    kind: &Kind,
    weight: f64,
) -> Tensor<1> {
    let mean = (a.clone() + b.clone()) * 0.5;
    // softmax(log q) = q / sum q: the loss sees the mean itself
    let log_mean = (mean + LEAST_PROBABILITY).log();
    let loss = label_loss(log_mean.clone(), labels, kind);
    let pixels = labels.len();
    if weight == 0.0 || pixels == 0 {
        return loss;
    }
    let to_mean =
        |p: Tensor<2>| sum_all(p.clone() * ((p + LEAST_PROBABILITY).log() - log_mean.clone()));
    loss + (to_mean(a) + to_mean(b)) * (0.5 * weight / pixels as f64)
}
