//! Adaptive density control: which Gaussians are cloned, split and pruned (3DGS, Kerbl et al. 2023), as pure functions on
//! host vectors.
//!
//! A [`RowPlan`] is decided once and then applied to the parameters and to the optimiser's moments alike, so that
//! row `i` of all of them stays the same Gaussian.

use super::initialization::logit;
use crate::error::{Error, Result};
use crate::splat::{Gaussians, Geometry, rotation};
use glam::Vec3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// A split divides the scales by this.
const SPLIT_SCALE: f32 = 1.6;
/// Opacity after a reset.
const RESET_OPACITY: f32 = 0.01;

/// Screen-space gradients gathered between densifications.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensityStats {
    /// Sum of |(dL/du W/2, dL/dv H/2)|, `[N]`; with AbsGS of sums of absolute values.
    pub gradient: Vec<f32>,
    /// Iterations in which the Gaussian was visible, `[N]`.
    pub visible: Vec<u32>,
}

impl DensityStats {
    /// Nothing gathered yet, for `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self {
            gradient: vec![0.0; n],
            visible: vec![0; n],
        }
    }

    /// Adds one iteration: `screen_gradient` is `[N, 2]` row-major, `radii` `[N]` with 0 for culled Gaussians.
    pub fn record(&mut self, screen_gradient: &[f32], radii: &[u32]) {
        let rows = screen_gradient.chunks_exact(2).zip(radii);
        for ((sum, count), (g, &radius)) in
            self.gradient.iter_mut().zip(&mut self.visible).zip(rows)
        {
            if radius > 0 {
                *sum += g[0].hypot(g[1]);
                *count += 1;
            }
        }
    }

    /// Mean over the iterations in which Gaussian `i` was visible; 0 when it never was.
    pub fn mean(&self, i: usize) -> f32 {
        if self.visible[i] == 0 {
            0.0
        } else {
            self.gradient[i] / self.visible[i] as f32
        }
    }
}

/// Largest scale that a Gaussian may have: a share of its distance from where the photos were taken, or of their extent where
/// that is longer. 3DGS takes the extent alone, by which cameras that are close to each other would lose everything behind
/// their subject.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizeLimit {
    /// Share of either length.
    pub share: f32,
    /// Extent of the scene, world units.
    pub extent: f32,
    /// Mean position of the cameras, world units.
    pub center: [f32; 3],
}

impl SizeLimit {
    /// The limit of a Gaussian at `mean`, world units.
    pub fn at(&self, mean: &[f32; 3]) -> f32 {
        self.share
            * self
                .extent
                .max(Vec3::from(*mean).distance(Vec3::from(self.center)))
    }
}

/// Thresholds of one densification, lengths in world units.
#[derive(Clone, Debug, PartialEq)]
pub struct DensityRules {
    /// Mean screen-space gradient above which a Gaussian is cloned or split.
    pub threshold: f32,
    /// Gaussians whose largest scale is at most this are cloned, others split.
    pub clone_below: f32,
    /// Gaussians less opaque than this are pruned.
    pub prune_opacity: f32,
    /// Gaussians whose largest scale is above this are pruned.
    pub prune_scale: SizeLimit,
    /// No more Gaussians than this afterwards; 0 means no limit. Highest gradients go first.
    pub max_gaussians: usize,
}

/// Where a row of the new set comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The old row, moments included.
    Kept,
    /// A copy of the old row, moments zero.
    Clone,
    /// One of two smaller samples of the old row, moments zero.
    Child,
}

/// The new set, row by row: kept rows in their order, then clones, then children.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowPlan {
    /// Old row and how it is used.
    pub rows: Vec<(u32, Origin)>,
    /// Gaussians that gained a clone.
    pub cloned: usize,
    /// Gaussians replaced by two children.
    pub split: usize,
    /// Gaussians removed without replacement.
    pub pruned: usize,
}

fn largest_scale(log_scales: &[f32; 3]) -> f32 {
    log_scales
        .iter()
        .copied()
        .fold(f32::NEG_INFINITY, f32::max)
        .exp()
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl RowPlan {
    /// Decides what happens to each Gaussian.
    ///
    /// Too transparent and (unless split into children that are small enough) too large ones go; of the rest, those
    /// whose mean gradient is at least the threshold are cloned or split, highest gradient first while the budget lasts.
    ///
    /// # Errors
    /// [`Error::Limit`] when the statistics are not those of these Gaussians.
    pub fn new<'a>(
        gaussians: impl Into<Geometry<'a>>,
        stats: &DensityStats,
        rules: &DensityRules,
    ) -> Result<Self> {
        let gaussians = gaussians.into();
        let n = gaussians.len();
        if stats.gradient.len() != n || stats.visible.len() != n {
            return Err(Error::Limit {
                what: "rows of the densification statistics".into(),
                found: stats.gradient.len().to_string(),
                limit: n.to_string(),
                help: "pass the statistics gathered for these Gaussians".into(),
            });
        }
        let scales: Vec<f32> = gaussians.log_scales.iter().map(largest_scale).collect();
        let opaque: Vec<bool> = gaussians
            .opacity_logits
            .iter()
            .map(|&o| sigmoid(o) >= rules.prune_opacity)
            .collect();
        let splits = |i: usize| scales[i] > rules.clone_below;
        let limits: Vec<f32> = gaussians
            .means
            .iter()
            .map(|mean| rules.prune_scale.at(mean))
            .collect();
        let fits = |i: usize| scales[i] <= limits[i];
        // A split saves a Gaussian that is too large if its children are not.
        let grows = |i: usize| {
            let scale = if splits(i) {
                scales[i] / SPLIT_SCALE
            } else {
                scales[i]
            };
            stats.mean(i) >= rules.threshold && opaque[i] && scale <= limits[i]
        };
        let mut grown: Vec<usize> = (0..n).filter(|&i| grows(i)).collect();
        if rules.max_gaussians > 0 {
            let survivors = (0..n).filter(|&i| opaque[i] && fits(i)).count();
            let mut budget = rules.max_gaussians.saturating_sub(survivors);
            grown.sort_by(|&a, &b| stats.mean(b).total_cmp(&stats.mean(a)).then(a.cmp(&b)));
            grown.retain(|&i| {
                // children of a Gaussian that would be pruned otherwise cost two rows
                let cost = if fits(i) { 1 } else { 2 };
                let affordable = cost <= budget;
                if affordable {
                    budget -= cost;
                }
                affordable
            });
            grown.sort_unstable();
        }
        let mut grow = vec![false; n];
        grown.iter().for_each(|&i| grow[i] = true);
        let (cloned, split): (Vec<usize>, Vec<usize>) =
            grown.into_iter().partition(|&i| !splits(i));
        let mut rows: Vec<(u32, Origin)> = (0..n)
            .filter(|&i| {
                if grow[i] {
                    !splits(i)
                } else {
                    opaque[i] && fits(i)
                }
            })
            .map(|i| (i as u32, Origin::Kept))
            .collect();
        let kept = rows.len();
        rows.extend(cloned.iter().map(|&i| (i as u32, Origin::Clone)));
        rows.extend(split.iter().flat_map(|&i| [(i as u32, Origin::Child); 2]));
        Ok(Self {
            pruned: n - kept - split.len(),
            cloned: cloned.len(),
            split: split.len(),
            rows,
        })
    }

    /// Old row of each new one, and whether its moments begin at zero.
    pub fn sources(&self) -> impl Iterator<Item = (u32, bool)> {
        self.rows
            .iter()
            .map(|&(row, origin)| (row, origin != Origin::Kept))
    }

    /// Means and log-scales of the new Gaussians, which have all else of their old rows. Children are drawn from their
    /// parent's distribution, in row order, with scales / 1.6.
    pub fn placed(
        &self,
        old: Geometry<'_>,
        rng: &mut ChaCha8Rng,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let place = |&(row, origin): &(u32, Origin)| {
            let i = row as usize;
            let (mean, log_scales) = (&old.means[i], &old.log_scales[i]);
            if origin != Origin::Child {
                return (*mean, *log_scales);
            }
            (
                sample(mean, log_scales, &old.rotations[i], rng),
                log_scales.map(|s| s - SPLIT_SCALE.ln()),
            )
        };
        self.rows.iter().map(place).unzip()
    }

    /// The new Gaussians, see [`RowPlan::placed`].
    pub fn gaussians(&self, old: &Gaussians, rng: &mut ChaCha8Rng) -> Gaussians {
        let (means, log_scales) = self.placed(old.into(), rng);
        let rows: Vec<u32> = self.rows.iter().map(|&(row, _)| row).collect();
        Gaussians {
            means,
            log_scales,
            ..old.select(&rows)
        }
    }

    /// Optimiser moments of the new rows: `old` is `[N, width]` row-major; those of new Gaussians are zero.
    pub fn moments(&self, old: &[f32], width: usize) -> Vec<f32> {
        let mut new = vec![0.0; self.rows.len() * width];
        for (&(row, origin), new) in self.rows.iter().zip(new.chunks_exact_mut(width.max(1))) {
            if origin == Origin::Kept {
                new.copy_from_slice(&old[row as usize * width..][..width]);
            }
        }
        new
    }
}

/// One sample of the Gaussian: mean + R diag(scales) z, z standard normal.
fn sample(
    mean: &[f32; 3],
    log_scales: &[f32; 3],
    quaternion: &[f32; 4],
    rng: &mut ChaCha8Rng,
) -> [f32; 3] {
    let mut z = [0.0; 3];
    z.iter_mut().for_each(|z| *z = standard_normal(rng));
    let local = glam::DVec3::from_array(std::array::from_fn(|k| {
        z[k] * f64::from(log_scales[k]).exp()
    }));
    let moved = rotation(quaternion) * local;
    std::array::from_fn(|k| (f64::from(mean[k]) + moved[k]) as f32)
}

/// Box-Muller; two uniform numbers a draw, so the stream's position does not depend on the values.
pub(crate) fn standard_normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Caps every opacity at 0.01 (a reset); the caller zeroes the opacity's moments.
pub fn reset_opacity(opacity_logits: &mut [f32]) {
    let cap = logit(RESET_OPACITY);
    opacity_logits.iter_mut().for_each(|o| *o = o.min(cap));
}
