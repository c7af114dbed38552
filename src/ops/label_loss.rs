//! Losses between softmaxed logits and one label a pixel, value and gradient in one pass.
//!
//! For a one-hot label every loss here but one is a function of p_y, the probability of the labelled class, alone. Its
//! gradient to logit k is therefore h (delta_ky - p_k) with h = p_y dL/dp_y, and no loop over classes but the softmax's.
//! [`Kind::NceRce`] also reads S = -sum_k ln p_k, which adds u (1 - K p_k) with u = -dL/dS for K classes.

use super::gradient_in_hand::with_gradient_in_hand;
use super::pixel_labels::PixelLabels;
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::Tensor;
use rayon::prelude::*;
use std::sync::Arc;

/// Pixels handled by one task; also the unit of the fixed summation order.
const BLOCK: usize = 1024;
/// The label of pixels that are not counted.
pub const UNLABELLED: u16 = u16::MAX;

/// Logarithm of a label's zeros in [`Kind::NceRce`] (Ma et al. 2020).
pub(super) const LOG_ZERO: f64 = -4.0;

/// A loss of the probabilities p of all classes, given the labelled one, y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Cross-entropy, -ln p_y.
    Ce,
    /// Jensen-Shannon (Eq. 8) with weight `pi_rl` of the raw label, in (0, 1), divided by Z = -(1 - pi_rl) ln(1 - pi_rl).
    /// Tends to cross-entropy for `pi_rl` to 0 and to [`Kind::Mae`] for `pi_rl` to 1.
    Js {
        /// Weight of the raw label.
        pi_rl: f64,
    },
    /// Generalised cross-entropy, (1 - p_y^q) / q, q in (0, 1].
    Gce {
        /// The exponent.
        q: f64,
    },
    /// Half the absolute error of the distribution, 1 - p_y.
    Mae,
    /// Normalised cross-entropy ln p_y / sum_k ln p_k plus reverse cross-entropy 4 (1 - p_y), alpha = beta = 1 (Ma et al.
    /// 2020, Normalized Loss Functions for Deep Learning with Noisy Labels).
    NceRce,
}

impl Kind {
    /// Whether the loss reads more than p_y.
    pub fn reads_all_classes(self) -> bool {
        self == Self::NceRce
    }

    /// The loss with its h and u, see the module; `log_sum` is sum_k ln p_k, and read only by such losses.
    fn of_row(self, log_p: f64, log_sum: impl FnOnce() -> f64) -> (f64, f64, f64) {
        let (loss, h) = self.of_log_probability(log_p);
        let all = if self.reads_all_classes() {
            -log_sum()
        } else {
            0.0
        };
        // A single class has no entropy to compare with.
        if all > 0.0 {
            (loss - log_p / all, h - 1.0 / all, -log_p / (all * all))
        } else {
            (loss, h, 0.0)
        }
    }

    /// The loss and p_y dL/dp_y, from ln p_y; of [`Kind::NceRce`] the part that depends on p_y alone.
    pub fn of_log_probability(self, log_p: f64) -> (f64, f64) {
        let p = log_p.exp();
        let rest = -log_p.exp_m1(); // 1 - p without cancellation
        match self {
            Self::Ce => (-log_p, -1.0),
            Self::Mae => (rest, -p),
            Self::NceRce => (-LOG_ZERO * rest, LOG_ZERO * p),
            Self::Gce { q } => (-(q * log_p).exp_m1() / q, -(q * log_p).exp()),
            Self::Js { pi_rl } => {
                let log_pi_p = (-pi_rl).ln_1p(); // ln(1 - pi_rl)
                // m = pi_rl + (1 - pi_rl) p = 1 - (1 - pi_rl)(1 - p), from whichever end keeps its digits
                let missing = (1.0 - pi_rl) * rest;
                let log_m = if missing < 0.5 {
                    (-missing).ln_1p()
                } else {
                    (pi_rl + (1.0 - pi_rl) * p).ln()
                };
                // ln(m / p) = ln(1 + pi_rl (1 - p) / p): the first form for small p, the second for small pi_rl
                let ratio = pi_rl * rest / p;
                let log_m_over_p = if ratio < 1.0 {
                    ratio.ln_1p()
                } else {
                    log_m - log_p
                };
                let label = -pi_rl * log_m;
                let prediction = (1.0 - pi_rl) * (-rest * log_pi_p - p * log_m_over_p);
                let z = -(1.0 - pi_rl) * log_pi_p;
                (
                    (label + prediction) / z,
                    p * (log_m_over_p - log_pi_p) / log_pi_p,
                )
            }
        }
    }
}

/// Least exponent of a softened loss: cross-entropy to a thousandth, down to probabilities of 1e-5.
const SOFTEST: f64 = 1e-4;

/// A loss whose robustness differs from class to class.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassLosses {
    /// The loss at its full robustness.
    pub kind: Kind,
    /// What the exponent of [`Kind::Gce`] is multiplied by for pixels labelled with a class, in 0..1: at 0 they learn by
    /// cross-entropy. 1 for classes beyond its end. Other losses stay as they are.
    pub shares: Vec<f64>,
}

impl From<Kind> for ClassLosses {
    fn from(kind: Kind) -> Self {
        Self {
            kind,
            shares: Vec::new(),
        }
    }
}

impl ClassLosses {
    /// The loss of pixels with this label.
    pub fn of(&self, class: usize) -> Kind {
        let share = self.shares.get(class).copied().unwrap_or(1.0);
        match self.kind {
            Kind::Gce { q } if share < 1.0 => Kind::Gce {
                q: (q * share).max(SOFTEST.min(q)),
            },
            other => other,
        }
    }
}

/// Mean loss over labelled pixels and its gradient: `logits` is `[P, classes]`, `labels` `[P]`. No labelled pixel: zeros.
pub fn value_and_gradient<E: Real>(
    logits: &[E],
    labels: &[u16],
    classes: usize,
    losses: &ClassLosses,
) -> (E, Vec<E>) {
    let mut gradient = vec![E::zero(); logits.len()];
    let count = labels.iter().filter(|&&l| l != UNLABELLED).count();
    if count == 0 || classes == 0 {
        return (E::zero(), gradient);
    }
    let scale = 1.0 / count as f64;
    let kinds: Vec<Kind> = (0..classes).map(|class| losses.of(class)).collect();
    let blocks = gradient
        .par_chunks_mut(BLOCK * classes)
        .zip(logits.par_chunks(BLOCK * classes));
    let sums: Vec<f64> = blocks
        .zip(labels.par_chunks(BLOCK))
        .map(|((gradient, logits), labels)| {
            let rows = gradient
                .chunks_exact_mut(classes)
                .zip(logits.chunks_exact(classes));
            let mut sum = 0.0;
            for ((gradient, logits), &label) in rows.zip(labels) {
                if label == UNLABELLED {
                    continue;
                }
                let mut highest = logits[0];
                for &z in logits {
                    highest = if z > highest { z } else { highest };
                }
                let y = usize::from(label);
                let mut others = E::zero();
                for (k, (g, &z)) in gradient.iter_mut().zip(logits).enumerate() {
                    *g = (z - highest).exp();
                    others += if k == y { E::zero() } else { *g };
                }
                let (own, total) = (gradient[y], others + gradient[y]);
                let log_total = total.wide().ln();
                let log_p = match logits[y] == highest {
                    true => -others.wide().ln_1p(), // a prediction that is nearly right keeps its digits
                    false => (logits[y] - highest).wide() - log_total,
                };
                let log_sum = || {
                    logits
                        .iter()
                        .map(|&z| (z - highest).wide() - log_total)
                        .sum()
                };
                let (loss, h, u) = kinds[y].of_row(log_p, log_sum);
                sum += loss;
                let factor = E::of(-(h + u * classes as f64) * scale) / total;
                let each = E::of(u * scale);
                gradient.iter_mut().for_each(|g| *g = *g * factor + each);
                // h (1 - p_y), not h - h p_y
                let [rest, p] = [others, own].map(|part| (part / total).wide());
                gradient[y] = E::of((h * rest + u * (1.0 - classes as f64 * p)) * scale);
            }
            sum
        })
        .collect();
    (E::of(sums.iter().sum::<f64>() * scale), gradient)
}

/// Backend side of [`label_loss`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait LabelLossBackend: Backend {
    /// The mean loss `[1]` of [`label_loss()`] and its gradient `[P, C]`.
    fn label_loss(
        logits: FloatTensor<Self>,
        labels: Arc<PixelLabels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostKernels> LabelLossBackend for B {
    fn label_loss(
        logits: FloatTensor<Self>,
        labels: Arc<PixelLabels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::label_loss::<Self>(logits, &labels, &losses)
    }
}

/// The loss by the CPU's kernel, wherever the tensor lives.
pub(super) mod on_host {
    use super::*;

    pub fn label_loss<B: HostBackend>(
        logits: FloatTensor<B>,
        labels: &[u16],
        losses: &ClassLosses,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, [rows, classes]) = (device_of::<B>(&logits), logits.shape().dims());
        real_kernel!(logits, E => {
            let (value, gradient) = value_and_gradient::<E>(&B::values(logits), labels, classes, losses);
            (B::tensor::<E>(vec![value], &[1], &device), B::tensor::<E>(gradient, &[rows, classes], &device))
        })
    }
}

impl<B: LabelLossBackend, C: CheckpointStrategy> LabelLossBackend for Autodiff<B, C> {
    fn label_loss(
        logits: FloatTensor<Self>,
        labels: Arc<PixelLabels>,
        losses: ClassLosses,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        with_gradient_in_hand::<B, C>(logits, |logits| B::label_loss(logits, labels, losses))
    }
}

/// Mean loss `[1]` over the labelled pixels, with gradient to `logits`.
///
/// `logits` is `[P, C]`; `labels` holds a class index a pixel, [`UNLABELLED`] where it is not counted. Without labelled
/// pixels the loss and its gradient are zero.
///
/// # Panics
/// If there is not one label a row, or a label is neither below C nor [`UNLABELLED`].
pub fn label_loss(logits: Tensor<2>, labels: &[u16], kind: &Kind) -> Tensor<1> {
    label_losses(logits, &Arc::new(labels.to_vec().into()), &(*kind).into())
}

/// [`label_loss`] with a loss for each class, of labels that a GPU takes up once.
///
/// # Panics
/// As [`label_loss`].
pub fn label_losses(
    logits: Tensor<2>,
    labels: &Arc<PixelLabels>,
    losses: &ClassLosses,
) -> Tensor<1> {
    let [rows, classes] = logits.dims();
    assert_eq!(
        labels.len(),
        rows,
        "label_loss: labels against rows of logits"
    );
    assert!(
        labels.end() <= classes,
        "label_loss: a label is no class index below {classes}"
    );
    let (value, _) = Dispatch::label_loss(logits.into_dispatch(), labels.clone(), losses.clone());
    Tensor::from_dispatch(value)
}
