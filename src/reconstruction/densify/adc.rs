//! Adaptive density control (3DGS, Kerbl et al. 2023).

use super::{Densification, Densified, GradientStatistics};
use crate::error::{Result, ensure};
use crate::random::standard_normal;
use crate::reconstruction::initialization::logit;
use crate::splat::{Gaussians, rotation};
use glam::{DVec3, Vec3};
use rand_chacha::ChaCha8Rng;

/// A split divides the scales by this.
const SPLIT_SCALE: f32 = 1.6;
/// Opacity after a reset.
const RESET_OPACITY: f32 = 0.01;

/// Largest scale that a Gaussian may have: a share of its distance from the mean camera, or of the extent where that is longer.
/// 3DGS takes the extent alone ([`SizeRule::Extent`](crate::config::SizeRule)). With that, cameras that stand close together lose
/// everything behind their subject.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizeLimit {
    /// Share of either length.
    pub share: f32,
    /// Extent of the scene, world units.
    pub extent: f32,
    /// Mean position of the cameras, world units; absent for the extent alone.
    pub center: Option<[f32; 3]>,
}

impl SizeLimit {
    /// The limit of a Gaussian at `mean`, world units.
    pub fn at(&self, mean: &[f32; 3]) -> f32 {
        let length = match self.center {
            Some(center) => Vec3::from(*mean).distance(center.into()).max(self.extent),
            None => self.extent,
        };
        self.share * length
    }
}

/// Thresholds of one densification, lengths in world units.
#[derive(Clone, Debug, PartialEq)]
pub struct AdcRules {
    /// Mean screen-space gradient from which a Gaussian is cloned or split.
    pub threshold: f32,
    /// Gaussians whose largest scale is at most this are cloned, others split.
    pub clone_below: f32,
    /// Gaussians less opaque than this are pruned.
    pub prune_opacity: f32,
    /// Gaussians whose largest scale is above this are pruned.
    pub prune_scale: SizeLimit,
    /// No more Gaussians than this afterwards. The highest gradients go first.
    pub max_gaussians: usize,
}

/// Clones, splits and prunes `old`, whose colours are not read.
///
/// Gaussians that are too transparent or too large go, unless a split leaves children that are small enough. Of the rest,
/// those whose mean gradient is at least the threshold are cloned or split, highest gradient first while the budget lasts. Two
/// children are drawn from their parent's distribution, with scales / 1.6. The new set has the kept rows in their order, then
/// the clones, then the children.
///
/// # Errors
/// [`crate::Error::Limit`] when the statistics are not those of these Gaussians.
pub fn adc(
    old: &Gaussians,
    stats: &GradientStatistics,
    rules: &AdcRules,
    rng: &mut ChaCha8Rng,
) -> Result<Densification> {
    let n = old.len();
    ensure!(stats.gradient.len() == n && stats.visible.len() == n,
        limit "rows of the densification statistics"; found "{}", stats.gradient.len(); expected "{n}";
        help "pass the statistics gathered for these Gaussians");
    let scales: Vec<f32> = old.log_scales.iter().map(largest_scale).collect();
    let is_large = |i: usize| scales[i] > rules.clone_below;
    let threshold = logit(rules.prune_opacity);
    let is_opaque = |i: usize| old.opacity_logits[i] >= threshold;
    let limits: Vec<f32> = old.means.iter().map(|m| rules.prune_scale.at(m)).collect();
    let stays = |i: usize| is_opaque(i) && scales[i] <= limits[i];
    // A split saves a Gaussian that is too large if its children are not.
    let grows = |i: usize| {
        let shrinks_by = if is_large(i) { SPLIT_SCALE } else { 1.0 };
        let fits = scales[i] / shrinks_by <= limits[i];
        fits && is_opaque(i) && stats.mean(i) >= rules.threshold
    };
    let mut grown: Vec<usize> = (0..n).filter(|&i| grows(i)).collect();
    let kept = (0..n).filter(|&i| stays(i)).count();
    let mut budget = rules.max_gaussians.saturating_sub(kept);
    grown.sort_by(|&a, &b| stats.mean(b).total_cmp(&stats.mean(a)).then(a.cmp(&b)));
    grown.retain(|&i| {
        // The children of a Gaussian that would be pruned otherwise cost two rows.
        let cost = if stays(i) { 1 } else { 2 };
        let affordable = cost <= budget;
        if affordable {
            budget -= cost;
        }
        affordable
    });
    grown.sort_unstable();
    let (split, cloned): (Vec<usize>, Vec<usize>) = grown.into_iter().partition(|&i| is_large(i));
    let mut is_split = vec![false; n];
    split.iter().for_each(|&i| is_split[i] = true);
    let kept: Vec<usize> = (0..n).filter(|&i| stays(i) && !is_split[i]).collect();
    Ok(densified(old, &kept, &cloned, &split, rng))
}

/// The rows `kept`, then copies of `cloned`, then two children of each of `split`.
fn densified(
    old: &Gaussians,
    kept: &[usize],
    cloned: &[usize],
    split: &[usize],
    rng: &mut ChaCha8Rng,
) -> Densification {
    let children = split.iter().flat_map(|i| [i; 2]);
    let rows: Vec<usize> = kept.iter().chain(cloned).chain(children).copied().collect();
    let copies = kept.len() + cloned.len();
    let mut is_new = vec![false; kept.len()];
    is_new.resize(rows.len(), true);
    let (means, log_scales) = rows
        .iter()
        .enumerate()
        .map(|(k, &i)| {
            if k < copies {
                (old.means[i], old.log_scales[i])
            } else {
                child(old, i, rng)
            }
        })
        .unzip();
    Densification {
        is_new,
        means,
        log_scales,
        opacity_logits: rows.iter().map(|&i| old.opacity_logits[i]).collect(),
        rows: rows.into_iter().map(|i| i as u32).collect(),
        done: Densified {
            cloned: cloned.len(),
            split: split.len(),
            pruned: old.len() - kept.len() - split.len(),
        },
    }
}

fn largest_scale(log_scales: &[f32; 3]) -> f32 {
    let [a, b, c] = *log_scales;
    a.max(b).max(c).exp()
}

/// Mean and log-scales of one child of Gaussian `i`: `mean + R diag(scales) z`, `z` standard normal.
fn child(old: &Gaussians, i: usize, rng: &mut ChaCha8Rng) -> ([f32; 3], [f32; 3]) {
    let z: [f64; 3] = std::array::from_fn(|_| standard_normal(rng));
    let scales = DVec3::from(old.log_scales[i].map(|s| f64::from(s).exp()));
    let offset = rotation(&old.rotations[i]) * (scales * DVec3::from(z));
    let mean = Vec3::from(old.means[i]).as_dvec3() + offset;
    let smaller = old.log_scales[i].map(|s| s - SPLIT_SCALE.ln());
    (mean.as_vec3().to_array(), smaller)
}

/// Caps every opacity at 0.01. The caller sets the moments of the opacities to zero.
pub fn reset_opacity(opacity_logits: &mut [f32]) {
    let cap = logit(RESET_OPACITY);
    opacity_logits.iter_mut().for_each(|o| *o = o.min(cap));
}
