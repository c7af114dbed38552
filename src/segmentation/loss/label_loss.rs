//! Losses between the class probabilities of a pixel and its label: a class, or a distribution over classes.

use crate::config::{self, SegmentationConfig};
use crate::error::Result;
use crate::segmentation::pixels::one_hot;
use burn::tensor::{Tensor, TensorData};

/// Keeps the logarithm of a blended probability finite.
pub(super) const MIN_PROBABILITY: f64 = 1e-8;
/// Keeps the logarithm finite of a mixture of two distributions that both lack a class. Its factor is 0 then.
const MIN_MIXTURE: f64 = 1e-30;
/// Least exponent of a softened [`LabelLoss::Gce`]: within a thousandth of cross-entropy for probabilities above 1e-5.
const SOFTEST: f64 = 1e-4;

/// A loss between the class probabilities p of a pixel and its label y.
///
/// The paper takes [`LabelLoss::Js`]. With the label as a one-hot distribution k, and m = pi k + (1 - pi) p, it is
///
/// ```text
/// (pi KL(k || m) + (1 - pi) KL(p || m)) / Z,   Z = -(1 - pi) ln(1 - pi)     (Eq. 8, without its sum over pixels)
/// ```
///
/// `jensen_shannon` in this file is its closed form. [`CoSegLoss`](super::CoSegLoss) takes the mean over pixels, and the setting
/// `segmentation.reduction = "sum"` makes it the sum of Eq. 8.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LabelLoss {
    /// Cross-entropy, -ln p_y.
    Ce,
    /// Generalised cross-entropy, (1 - p_y^q) / q (Zhang and Sabuncu 2018). It is the absolute error 1 - p_y at q = 1.
    Gce {
        /// The exponent, in (0, 1].
        q: f64,
    },
    /// Jensen-Shannon (Eq. 8), divided by Z = -(1 - pi) ln(1 - pi). It tends to [`LabelLoss::Ce`] as `pi` goes to 0 and to
    /// the absolute error 1 - p_y as `pi` goes to 1.
    Js {
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
        let loss = config.loss();
        loss.check()?;
        Ok(match loss {
            config::LabelLoss::Ce => Self::Ce,
            config::LabelLoss::Gce { exponent: q, .. } => Self::Gce { q },
            config::LabelLoss::Js { pi_rl: pi } => Self::Js { pi },
        })
    }

    /// Losses `[P, 1]` of pixels against distributions `y` `[P, C]`, given the logarithms of their class probabilities. For one-hot
    /// `y` they are those of [`LabelLoss::of_pixels`].
    pub(super) fn of_distributions(
        self,
        log_p: Tensor<2>,
        y: Tensor<2>,
        robustness: &[f64],
    ) -> Tensor<2> {
        match self {
            Self::Ce => (log_p * y).sum_dim(1).neg(),
            Self::Gce { q } => {
                let classes = log_p.dims()[1];
                let q = TensorData::new(exponents(q, robustness, 0..classes), [1, classes]);
                (generalised_cross_entropy(log_p, q) * y).sum_dim(1)
            }
            Self::Js { pi } => {
                let p = log_p.clone().exp();
                let m = p.clone() * (1.0 - pi) + y.clone() * pi;
                let log_m = m.clamp_min(MIN_MIXTURE).log();
                let log_y = (y.clone() + MIN_PROBABILITY).log();
                let label = (y * (log_y - log_m.clone())).sum_dim(1);
                let prediction = (p * (log_p - log_m)).sum_dim(1);
                let z = -(1.0 - pi) * (-pi).ln_1p();
                label * (pi / z) + prediction * ((1.0 - pi) / z)
            }
        }
    }

    /// Losses `[P, 1]` of pixels.
    pub(super) fn of_pixels(self, own: OwnClass) -> Tensor<2> {
        match self {
            Self::Ce => own.log_p.neg(),
            Self::Gce { q } => generalised_cross_entropy(own.log_p, [[q]]),
            Self::Js { pi } => jensen_shannon(own, pi),
        }
    }
}

/// (1 - p^q) / q for exponents `q`, `[P, 1]`, `[1, C]` or `[1, 1]`. Near p = 1 the difference 1 - exp(x) would lose its digits: there it
/// is 2 t / (1 + t) with t = tanh(-x / 2), by the continued fraction of tanh, which is plain arithmetic on every device.
pub(super) fn generalised_cross_entropy(log_p: Tensor<2>, q: impl Into<TensorData>) -> Tensor<2> {
    let q: Tensor<2> = Tensor::from_data(q, (&log_p.device(), log_p.dtype()));
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
    let OwnClass { log_p, p, rest } = own;
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
    let z = -(1.0 - pi) * log_rest_weight;
    // The weight of 1 - p_y is (1 - pi) / Z times -ln(1 - pi), which is 1. GPUs round the smallest numbers to 0, so each term
    // is divided by Z before they are added.
    log_m * (-pi / z) + rest - p * log_m_over_p * ((1.0 - pi) / z)
}

/// What the losses read of a pixel's class probabilities, `[P, 1]` each.
pub(super) struct OwnClass {
    /// ln p_y.
    pub log_p: Tensor<2>,
    /// p_y.
    p: Tensor<2>,
    /// 1 - p_y.
    rest: Tensor<2>,
}

impl OwnClass {
    /// From `logits` `[P, C]` of labelled pixels: softmax over the margins z_k - z_y, whose sum without the label's own
    /// term keeps the digits of 1 - p_y. The shift is a constant that cancels.
    pub fn of_logits(logits: Tensor<2>, labels: &[u16]) -> Self {
        let own = one_hot(labels, &logits);
        let margins = logits.clone() - (logits * own.clone()).sum_dim(1);
        let shift = margins.clone().detach().max_dim(1);
        let own_power = shift.clone().neg().exp();
        let others = ((margins - shift.clone()).exp() * (own.neg() + 1.0)).sum_dim(1);
        let total = others.clone() + own_power.clone();
        let log_p = (log1p(others.clone() + (own_power.clone() - 1.0)) + shift).neg();
        let p = own_power / total.clone();
        // Each form keeps the digits of values and gradients where the other cancels.
        let rest = (others / total).mask_where(p.clone().lower_elem(0.5), p.clone().neg() + 1.0);
        Self { log_p, p, rest }
    }

    /// From blended probabilities `[P, 1]` of the labelled classes.
    pub fn of_probabilities(p: Tensor<2>, classes: usize) -> Self {
        let total = 1.0 + classes as f64 * MIN_PROBABILITY;
        let p = ((p + MIN_PROBABILITY) * total.recip()).clamp_max(1.0);
        Self {
            log_p: p.clone().log(),
            rest: p.clone().neg() + 1.0,
            p,
        }
    }
}

/// The exponents of [`LabelLoss::Gce`] for `classes`, see [`CoSegLoss::robustness`](super::CoSegLoss::robustness).
pub(super) fn exponents(
    q: f64,
    robustness: &[f64],
    classes: impl Iterator<Item = usize>,
) -> Vec<f32> {
    let share = |class: usize| robustness.get(class).map_or(1.0, |&share| share);
    let exponent = |class| (q * share(class)).max(SOFTEST.min(q)) as f32;
    classes.map(exponent).collect()
}
