//! 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591): relocation and growth, and the noise on the means.
//!
//! A transparent Gaussian moves onto an opaque one. Where `N` Gaussians then stand instead of one, their opacity and scale are
//! corrected (Eq. 9 of the paper) so that together they look like the one.

use super::densify::{Densification, Densified};
use super::initialization::logit;
use crate::random::normals;
use crate::raster::SplatTensors;
use crate::splat::{Geometry, ZERO_QUATERNION};
use burn::tensor::{Tensor, activation};
use rand::distr::Distribution;
use rand::distr::weighted::WeightedIndex;
use rand_chacha::ChaCha8Rng;

/// Largest opacity that differs from 1, `1 - f32::EPSILON`, as a logit.
const OPAQUE: f64 = 15.942_385_033_669_446;
/// Step of the quadrature in [`covered`], standard deviations.
const STEP: f64 = 0.125;
/// Steps of the quadrature on either side of the centre.
const STEPS: u32 = 88;

/// `copies` Gaussians at one place that together look like one of opacity `sigmoid(logit)`: the opacity logit of each, and the
/// shift of their log-scales. The new logit is at least `floor`.
///
/// Eq. 9: with the old opacity `o`, `o' = 1 - (1 - o)^(1/N)`, so that all of them together let as much light through at the
/// centre, and the scales times `o / D`,
/// `D = sum_(i=1..N) sum_(k=0..i-1) C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1)`,
/// so that they cover as much along a line through the centre: `D sqrt(2 pi)` is the integral over x of
/// `1 - (1 - o' exp(-x^2 / 2))^N`. This function computes the integral. The terms of the sum grow like those of `exp(-N o')`, and
/// would leave nothing but rounding where many Gaussians share a place; so `N` needs no limit.
///
/// Where `floor` raises the opacity, the scales follow from the raised one, and the integral is still the old one.
pub fn shared(logit: f32, copies: u32, floor: f32) -> (f32, f32) {
    let n = f64::from(copies.max(1));
    let logit = f64::from(logit).min(OPAQUE);
    // ln(1 - o) = -ln(1 + e^logit), which keeps the digits of 1 - o.
    let each = -(logit.max(0.0) + (-logit.abs()).exp().ln_1p()) / n;
    // o' / (1 - o') = e^-each - 1
    let new = ((-each).exp_m1().ln() as f32).max(floor);
    let ratio = covered(sigmoid(logit), 1.0) / covered(sigmoid(f64::from(new)), n);
    (new, ratio.ln() as f32)
}

/// `D` of [`shared`], by the trapezoidal rule: exact to rounding for a sum of Gaussians wider than a few steps.
fn covered(opacity: f64, copies: f64) -> f64 {
    let at = |x: f64| -(copies * (-opacity * (-0.5 * x * x).exp()).ln_1p()).exp_m1();
    let half = 0.5 * at(0.0) + (1..=STEPS).map(|k| at(STEP * f64::from(k))).sum::<f64>();
    half * STEP * std::f64::consts::FRAC_2_SQRT_PI * std::f64::consts::FRAC_1_SQRT_2
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Limits of one relocation.
#[derive(Clone, Debug, PartialEq)]
pub struct RelocationRules {
    /// Gaussians of this opacity or less are moved.
    pub dead: f32,
    /// Share of the present Gaussians that is added, rounded up.
    pub growth: f64,
    /// No more Gaussians than this afterwards; the present ones stay.
    pub max_gaussians: usize,
}

/// Moves dead Gaussians and adds new ones: the old rows in their places, then the added ones.
///
/// For each Gaussian to move and each to add, one of the live ones is drawn from `rng` with replacement, with a probability
/// proportional to its opacity. Where none is live, nothing happens.
///
/// What is copied keeps its moments, and the copies start from zero: Gaussians alike in everything have the same gradients, and
/// with the same moments they would stay together.
pub fn relocate<'a>(
    gaussians: impl Into<Geometry<'a>>,
    rules: &RelocationRules,
    rng: &mut ChaCha8Rng,
) -> Densification {
    let old = gaussians.into();
    let n = old.len();
    let threshold = logit(rules.dead);
    let (live, dead): (Vec<usize>, Vec<usize>) =
        (0..n).partition(|&i| old.opacity_logits[i] > threshold);
    let mut rows: Vec<usize> = (0..n).collect();
    let mut copies = vec![1_u32; n];
    let mut done = Densified::default();
    let opacities = live
        .iter()
        .map(|&i| sigmoid(f64::from(old.opacity_logits[i])));
    if let Ok(drawn) = WeightedIndex::new(opacities) {
        let wanted = ((1.0 + rules.growth) * n as f64).ceil() as usize;
        let added = n..wanted.min(rules.max_gaussians);
        done = Densified {
            cloned: added.len(),
            relocated: dead.len(),
            ..done
        };
        rows.resize(n + added.len(), 0);
        dead.iter().for_each(|&i| copies[i] = 0);
        for i in dead.into_iter().chain(added) {
            rows[i] = live[drawn.sample(rng)];
            copies[rows[i]] += 1;
        }
    }
    // Just above the threshold, so that a copy does not count as transparent.
    let floor = threshold.next_up();
    let corrected = |&i: &usize| {
        if copies[i] < 2 {
            return (old.opacity_logits[i], old.log_scales[i]);
        }
        let (logit, wider) = shared(old.opacity_logits[i], copies[i], floor);
        (logit, old.log_scales[i].map(|s| s + wider))
    };
    let (opacity_logits, log_scales) = rows.iter().map(corrected).unzip();
    Densification {
        is_new: rows.iter().enumerate().map(|(i, &row)| row != i).collect(),
        means: rows.iter().map(|&i| old.means[i]).collect(),
        log_scales,
        opacity_logits,
        rows: rows.into_iter().map(|i| i as u32).collect(),
        done,
    }
}

/// `scale sigmoid(-k (o - t)) Sigma eta` for a Gaussian of opacity `o` and covariance `Sigma`, with a standard normal `eta`. The
/// noise lies along the axes of the Gaussian, and only nearly transparent Gaussians get any.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionNoise {
    /// One over world units: the noise is a length, `Sigma` the square of one.
    pub scale: f64,
    /// `k`.
    pub sharpness: f64,
    /// `t`.
    pub opacity: f64,
}

impl PositionNoise {
    /// The means of `splats` with noise, `[N, 3]`. The bits depend on the device, but not on the number of threads.
    pub fn apply(&self, splats: &SplatTensors, rng: &mut ChaCha8Rng) -> Tensor<2> {
        let means = splats.means.clone();
        let rotations = splats.rotations.clone();
        let n = splats.len();
        if n == 0 {
            return means;
        }
        let noise = normals([n, 3], rng, &means.device());
        let opacity = activation::sigmoid(splats.opacity_logits.clone()).reshape([n, 1]);
        let gate = activation::sigmoid((opacity - self.opacity) * -self.sharpness);
        let squared = (rotations.clone() * rotations.clone()).sum_dim(1);
        let no_rotation = squared.clone().lower_elem(ZERO_QUATERNION);
        let unit = rotations * squared.sqrt().recip().mask_fill(no_rotation, 0.0);
        let real = unit.clone().slice([0..n, 0..1]);
        let imaginary = unit.slice([0..n, 1..4]);
        // R x = x + 2 (w (v x) + v (v x)) with cross products; the inverse has -w.
        let rotate = |x: Tensor<2>, real: Tensor<2>| {
            let across = imaginary.clone().cross(x.clone(), 1);
            x + (across.clone() * real + imaginary.clone().cross(across, 1)) * 2.0
        };
        // Sigma eta = R diag(variance) R^T eta
        let variance = (splats.log_scales.clone() * 2.0).exp();
        let local = rotate(noise, real.clone().neg()) * variance;
        means + rotate(local, real) * gate * self.scale
    }
}
