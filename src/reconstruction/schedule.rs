//! The schedule of stage one: learning rates, SH degree, densification, resets, order of views.
//!
//! Steps count from 1, and each is one view: an optimiser step of a batch takes as many. Everything is a function of the step, so a
//! resumed run needs no memory of it.

use crate::config::{Budget, BuildingConfig};
use crate::data::{Points, View};
use crate::random::{Purpose, in_epochs};
use crate::splat::camera::spread;
use glam::{DVec3, Vec3};

/// Learning rate of the means at the end of the run, as a share of the first.
const FINAL_RATE: f64 = 0.01;
/// Densification starts at this share of the run at the latest.
const LATEST_START: f64 = 0.08;
/// Passes over all views between two opacity resets, at least.
const PASSES_BETWEEN_RESETS: usize = 5;

/// Held-back views train again after this share of the run.
const REJOIN: f64 = 0.75;
/// Shares of the run at which the number of Gaussians is reviewed after densification.
const REVIEWS: [f64; 2] = [0.625, 0.75];
/// One of this many training views is held back.
const HELD_BACK_EVERY: usize = 12;
/// At least and at most this many are held back.
const HELD_BACK: std::ops::RangeInclusive<usize> = 3..=8;

/// Indices of the views to hold back of `views`, evenly spaced; none of fewer than twelve.
fn held_back(views: usize) -> Vec<usize> {
    if views < HELD_BACK_EVERY {
        return Vec::new();
    }
    let count = (views / HELD_BACK_EVERY).clamp(*HELD_BACK.start(), *HELD_BACK.end());
    (0..count)
        .map(|k| (2 * k + 1) * views / (2 * count))
        .collect()
}

/// The schedule of one run.
#[derive(Clone, Debug)]
pub struct Schedule {
    config: BuildingConfig,
    extent: f64,
    /// Indices of the training views that judge the number of Gaussians.
    judges: Vec<usize>,
    /// All indices, and those of the views that are trained on while the judges are held back.
    all: Vec<usize>,
    others: Vec<usize>,
}

impl Schedule {
    /// The schedule of a run over `views` training views of a scene of size `extent` (world units).
    pub fn new(config: &BuildingConfig, views: usize, extent: f64) -> Self {
        let held_back = match config.max_gaussians {
            Budget::Auto => held_back(views),
            Budget::Unlimited | Budget::AtMost(_) => Vec::new(),
        };
        let all: Vec<usize> = (0..views).collect();
        let others = all.iter().copied().filter(|i| !held_back.contains(i));
        Self {
            config: config.clone(),
            extent,
            others: others.collect(),
            judges: if held_back.is_empty() {
                all.clone()
            } else {
                held_back
            },
            all,
        }
    }

    /// Indices of the training views that judge the number of Gaussians: the held-back ones, or all if there are too few.
    pub fn judges(&self) -> &[usize] {
        &self.judges
    }

    /// Indices of the views that are trained on at `step`.
    pub fn trained(&self, step: usize) -> &[usize] {
        if step <= self.share(REJOIN) {
            &self.others
        } else {
            &self.all
        }
    }

    /// Whether the number of Gaussians is reviewed after `step`.
    pub fn reviews(&self, step: usize) -> bool {
        let late = REVIEWS.map(|share| self.share(share));
        self.config.max_gaussians == Budget::Auto
            && (self.resets(step) || step == self.densify_until() || late.contains(&step))
    }

    /// Whether densification may add Gaussians after `step`.
    pub fn grows(&self, step: usize) -> bool {
        step < self.densify_until()
    }

    /// The step at this share of the run.
    fn share(&self, share: f64) -> usize {
        (share * self.config.iterations as f64) as usize
    }

    /// Learning rate of the means: exponential from `lr_means` to a hundredth of it, times the extent.
    pub fn means_rate(&self, step: usize) -> f64 {
        let share = step.saturating_sub(1) as f64 / self.config.iterations.max(1) as f64;
        self.config.lr_means * FINAL_RATE.powf(share) * self.extent
    }

    /// SH degree in use: one more at each eighth of the run, up to the third and to `sh_degree`. A run that starts from given
    /// Gaussians uses all degrees from the first step.
    pub fn sh_degree(&self, step: usize) -> usize {
        if self.config.gaussians.is_some() {
            return self.config.sh_degree;
        }
        let eighths = 8 * step.saturating_sub(1) / self.config.iterations.max(1);
        eighths.min(3).min(self.config.sh_degree)
    }

    /// Whether the Gaussians are densified after `step`.
    pub fn densifies(&self, step: usize) -> bool {
        let from = self.config.densify_from.min(self.share(LATEST_START));
        step.is_multiple_of(self.config.densify_every.max(1))
            && step >= from
            && step <= self.densify_until()
    }

    /// Whether opacities are reset after `step`.
    pub fn resets(&self, step: usize) -> bool {
        step.is_multiple_of(self.reset_every()) && step < self.densify_until()
    }

    /// Steps between two resets.
    pub fn reset_every(&self) -> usize {
        let passes = PASSES_BETWEEN_RESETS * self.all.len();
        self.config.reset_every.max(passes).max(1)
    }

    /// Whether the held-out views are scored after `step`.
    pub fn evaluates(&self, step: usize) -> bool {
        self.is_due(self.config.eval_every, step)
    }

    /// Whether a checkpoint is written after `step`.
    pub fn saves(&self, step: usize) -> bool {
        self.is_due(self.config.checkpoint_every, step)
    }

    /// Every `interval` steps (0: ten times in the run) and at the end.
    fn is_due(&self, interval: usize, step: usize) -> bool {
        let interval = if interval == 0 {
            self.config.iterations.div_ceil(10)
        } else {
            interval
        };
        step.is_multiple_of(interval.max(1)) || step == self.config.iterations
    }

    /// Index among the training views at `step`: each epoch is a shuffle of the views that are trained on.
    pub fn view(&self, seed: u64, step: usize) -> usize {
        let views = self.trained(step).to_vec();
        in_epochs(views, seed, Purpose::ViewOrder, step.max(1) - 1)
    }

    /// Whether the background of `step` may be random: as long as densification and resets change opacities.
    pub fn varies_background(&self, step: usize) -> bool {
        step <= self.densify_until()
    }

    fn densify_until(&self) -> usize {
        self.share(self.config.densify_until.into())
    }
}

/// Cameras that reach less than this share of the distance of what they see count as standing at one place.
const MIN_SPREAD: f64 = 1e-6;

/// Mean position of the cameras, world units; the origin without any.
pub fn center(views: &[&View]) -> DVec3 {
    spread(views.iter().map(|v| v.camera.center)).0
}

/// Size of the scene in world units: 1.1 times the largest distance of a camera from the mean camera.
///
/// Where all cameras stand at one place, the rms distance of the points from it, or 1 without points.
pub fn extent(views: &[&View], points: &Points) -> f64 {
    let (mean, reach) = spread(views.iter().map(|v| v.camera.center));
    let squared: f64 = points
        .positions
        .iter()
        .map(|&p| Vec3::from(p).as_dvec3().distance_squared(mean))
        .sum();
    let rms = (squared / points.positions.len().max(1) as f64).sqrt();
    let surroundings = if rms.is_finite() && rms > 0.0 {
        rms
    } else {
        1.0
    };
    // Poses of one tripod differ by the rounding of the program that wrote them.
    if reach > MIN_SPREAD * surroundings {
        1.1 * reach
    } else {
        surroundings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(iterations: usize, views: usize) -> Schedule {
        let config = BuildingConfig {
            iterations,
            ..BuildingConfig::default()
        };
        Schedule::new(&config, views, 2.0)
    }

    #[test]
    fn rates_degrees_and_intervals_are_those_of_the_design() {
        let s = schedule(7000, 50);
        assert!((s.means_rate(1) - 3.2e-4).abs() < 1e-12);
        assert!((s.means_rate(7001) - 3.2e-6).abs() < 1e-14);
        assert!((s.means_rate(3501) - 3.2e-5).abs() < 1e-12);
        let degrees = [1, 875, 876, 1750, 1751, 2625, 2626, 7000].map(|step| s.sh_degree(step));
        assert_eq!(degrees, [0, 0, 1, 1, 2, 2, 3, 3]);
        let densified: Vec<usize> = (1..=7000).filter(|&step| s.densifies(step)).collect();
        assert_eq!(
            (densified[0], densified[1], densified.last()),
            (500, 600, Some(&3500))
        );
        assert!(s.varies_background(1) && s.varies_background(3500) && !s.varies_background(3501));
        let resets: Vec<usize> = (1..=7000).filter(|&step| s.resets(step)).collect();
        assert_eq!(resets, [1000, 2000, 3000]);
        assert_eq!((1..=7000).filter(|&step| s.evaluates(step)).count(), 10);
    }

    #[test]
    fn short_runs_and_many_views_stretch_the_schedule() {
        assert_eq!(
            (1..=2000).find(|&step| schedule(2000, 10).densifies(step)),
            Some(200)
        );
        let resets: Vec<usize> = (1..=7000)
            .filter(|&step| schedule(7000, 300).resets(step))
            .collect();
        assert_eq!(resets, [1500, 3000]);
        let tiny: Vec<usize> = (1..=3)
            .filter(|&step| schedule(3, 1).evaluates(step))
            .collect();
        assert_eq!(tiny, [1, 2, 3]);
    }

    #[test]
    fn every_epoch_visits_every_view_once() {
        let s = schedule(100, 7);
        let epoch = |e: usize| -> Vec<usize> { (1..=7).map(|k| s.view(5, 7 * e + k)).collect() };
        let sorted = |mut v: Vec<usize>| {
            v.sort_unstable();
            v
        };
        for e in 0..5 {
            assert_eq!(sorted(epoch(e)), [0, 1, 2, 3, 4, 5, 6]);
        }
        assert!((1..5).any(|e| epoch(e) != epoch(0)));
    }

    #[test]
    fn held_back_views_judge_and_join_the_last_quarter() {
        let s = schedule(7_000, 48);
        assert_eq!(s.judges(), [6, 18, 30, 42]);
        let views = |steps: std::ops::RangeInclusive<usize>| {
            let views: std::collections::BTreeSet<usize> =
                steps.map(|step| s.view(5, step)).collect();
            views
        };
        let early = views(1..=5_250);
        assert_eq!(early.len(), 44);
        assert!(s.judges().iter().all(|view| !early.contains(view)));
        assert_eq!(views(5_251..=7_000).len(), 48);
        let reviewed: Vec<usize> = (1..=7_000).filter(|&step| s.reviews(step)).collect();
        assert_eq!(reviewed, [1_000, 2_000, 3_000, 3_500, 4_375, 5_250]);

        let few = schedule(7_000, 11);
        assert_eq!(few.judges().len(), 11);
        assert_eq!(few.trained(1).len(), 11);
        let config = BuildingConfig {
            max_gaussians: Budget::Unlimited,
            ..BuildingConfig::default()
        };
        let unlimited = Schedule::new(&config, 48, 2.0);
        assert_eq!(unlimited.trained(1).len(), 48);
        assert!((1..=7_000).all(|step| !unlimited.reviews(step)));
    }
}
