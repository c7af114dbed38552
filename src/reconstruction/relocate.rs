//! Relocation and growth of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591), as pure functions on host vectors.
//!
//! A transparent Gaussian is worth more elsewhere: it becomes a copy of an opaque one. Where `N` Gaussians then stand
//! instead of one, their opacity and scale are corrected (Eq. 9 of the paper) so that they look like the one.
//!
//! A [`RelocationPlan`] is decided once and then applied to the parameters and to the optimiser's moments alike.

use super::initialization::logit;
use crate::splat::{Gaussians, Geometry};
use rand::distr::Distribution;
use rand::distr::weighted::WeightedIndex;
use rand_chacha::ChaCha8Rng;

/// Largest opacity that is told apart from 1, `1 - f32::EPSILON`, as a logit.
const OPAQUE: f64 = 15.942_385_033_669_446;

/// Step of the quadrature in [`covered`], standard deviations, and how far out it goes.
const STEP: f64 = 0.125;
const STEPS: u32 = 88;

/// What each of `copies` Gaussians at one place must be, to look like one of opacity `sigmoid(logit)`: the logit of their
/// opacity, and what is added to their log-scales. The new logit is at least `floor`.
///
/// Eq. 9: with `o` the old opacity, `o' = 1 - (1 - o)^(1/N)`, so that all of them together let as much light through at the
/// centre, and the scales times `o / D`,
/// `D = sum_(i=1..N) sum_(k=0..i-1) C(i-1, k) (-1)^k o'^(k+1) / sqrt(k+1)`,
/// so that what they cover along a line through the centre is the same: `D sqrt(2 pi)` is the integral over x of
/// `1 - (1 - o' exp(-x^2 / 2))^N`. The integral is what is computed here. The terms of the sum grow like those of
/// `exp(-N o')`, of which nothing would be left but rounding where many Gaussians share a place; so `N` needs no limit.
///
/// Where `floor` lifts the opacity, the scales follow from the lifted one, and the integral is still the old one.
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

/// `1 / (1 + e^-x)`.
pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Limits of one relocation.
#[derive(Clone, Debug, PartialEq)]
pub struct RelocationRules {
    /// Gaussians of this opacity or less are moved.
    pub dead: f32,
    /// Share of the Gaussians there are that is added, rounded up.
    pub growth: f64,
    /// No more Gaussians than this afterwards; those there are stay.
    pub max_gaussians: usize,
}

/// The new set, row by row: the old rows in their places, then those that are added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RelocationPlan {
    /// Old row that each new one is a copy of.
    pub rows: Vec<u32>,
    /// New rows that are copies of each old one.
    pub copies: Vec<u32>,
    /// Gaussians that were moved.
    pub relocated: usize,
    /// Gaussians that were added.
    pub added: usize,
    /// Lowest logit of the opacity of a copy.
    floor: f32,
}

impl RelocationPlan {
    /// Decides what becomes of Gaussians of these opacities, `[N]` logits.
    ///
    /// For each Gaussian to move and each to add one of the others is drawn from `rng`, with replacement, as likely as it is
    /// opaque. Where none is left to draw, nothing happens.
    pub fn new(opacity_logits: &[f32], rules: &RelocationRules, rng: &mut ChaCha8Rng) -> Self {
        let n = opacity_logits.len();
        let threshold = logit(rules.dead);
        let (live, dead): (Vec<u32>, Vec<u32>) =
            (0..n as u32).partition(|&i| opacity_logits[i as usize] > threshold);
        let mut plan = Self {
            rows: (0..n as u32).collect(),
            copies: vec![1; n],
            // what was just moved must not count as transparent
            floor: threshold.next_up(),
            ..Self::default()
        };
        let opacities = live
            .iter()
            .map(|&i| sigmoid(f64::from(opacity_logits[i as usize])));
        let Ok(drawn) = WeightedIndex::new(opacities) else {
            return plan;
        };
        let mut draw = |plan: &mut Self| {
            let source = live[drawn.sample(rng)];
            plan.copies[source as usize] += 1;
            source
        };
        for &i in &dead {
            plan.copies[i as usize] = 0;
            plan.rows[i as usize] = draw(&mut plan);
        }
        let wanted = ((1.0 + rules.growth) * n as f64).ceil() as usize;
        for _ in n..wanted.min(rules.max_gaussians) {
            let source = draw(&mut plan);
            plan.rows.push(source);
        }
        Self {
            relocated: dead.len(),
            added: plan.rows.len() - n,
            ..plan
        }
    }

    /// Old row of each new one, and whether its moments begin at zero.
    pub fn sources(&self) -> impl Iterator<Item = (u32, bool)> {
        self.rows
            .iter()
            .enumerate()
            .map(|(i, &row)| (row, row as usize != i))
    }

    /// Opacity logits and log-scales of the new Gaussians, which have all else of their old rows.
    pub fn corrected(&self, old: Geometry<'_>) -> (Vec<f32>, Vec<[f32; 3]>) {
        let correct = |&row: &u32| {
            let (logit, log_scales) = (
                old.opacity_logits[row as usize],
                old.log_scales[row as usize],
            );
            match self.copies[row as usize] {
                0 | 1 => (logit, log_scales),
                copies => {
                    let (logit, wider) = shared(logit, copies, self.floor);
                    (logit, log_scales.map(|s| s + wider))
                }
            }
        };
        self.rows.iter().map(correct).unzip()
    }

    /// The new Gaussians, see [`RelocationPlan::corrected`].
    pub fn gaussians(&self, old: &Gaussians) -> Gaussians {
        let (opacity_logits, log_scales) = self.corrected(old.into());
        Gaussians {
            opacity_logits,
            log_scales,
            ..old.select(&self.rows)
        }
    }

    /// Optimiser moments of the new rows: `old` is `[N, width]` row-major; those of copies are zero.
    ///
    /// What was copied keeps its own. Gaussians alike in everything have the same gradients; with the same moments as well they
    /// would stay together, and be one Gaussian at the cost of several.
    pub fn moments(&self, old: &[f32], width: usize) -> Vec<f32> {
        let mut new = vec![0.0; self.rows.len() * width];
        for (i, (&row, new)) in self
            .rows
            .iter()
            .zip(new.chunks_exact_mut(width.max(1)))
            .enumerate()
        {
            if row as usize == i {
                new.copy_from_slice(&old[i * width..][..width]);
            }
        }
        new
    }
}
