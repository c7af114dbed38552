//! `building.max_gaussians = "auto"`: the scene decides how many Gaussians it gets.
//!
//! Some training views are held back for three quarters of the run. Before each reset of opacities, and a few times after
//! densification has ended, a review leaves out the Gaussians that the held-back views hardly miss. Growth may then make at most
//! [`GROWTH`] times as many as stayed. It ends when the views that are trained on are reproduced much better than those held back:
//! from then on more Gaussians would learn single photos, not the scene.

use super::Trainer;
use super::pruning::{PrunedScene, evenly};
use crate::config::Budget;
use crate::data::View;
use crate::error::Result;
use crate::progress::Review;
use crate::random::{Purpose, stream};

/// The PSNR of held-back views that a review may take, dB. Training goes on afterwards and wins it back.
const LOSS: f64 = 0.05;
/// Between two reviews the number of Gaussians grows by this factor at most.
const GROWTH: f64 = 4.0;
/// Growth ends when the PSNR of views that are trained on is this far above that of held-back ones, dB.
const MAX_GAP: f64 = 3.0;
/// Training views that a review measures the Gaussians in, at most.
const MEASURED_VIEWS: usize = 48;

impl<'a> Trainer<'a> {
    /// No more Gaussians than this after a densification.
    pub(super) fn capacity(&self) -> usize {
        match self.config.building.max_gaussians {
            Budget::Unlimited => usize::MAX,
            Budget::AtMost(limit) => limit,
            Budget::Auto => {
                let last = self.reviews.last();
                let kept = last.map_or(self.initial, |review| review.kept);
                let learns_photos =
                    last.is_some_and(|review| review.psnr_trained > review.psnr_before + MAX_GAP);
                if learns_photos || !self.schedule.grows(self.iteration) {
                    kept
                } else {
                    (GROWTH * kept as f64) as usize
                }
            }
        }
    }

    /// Leaves out what the held-back views do not miss.
    pub(super) fn review(&mut self) -> Result<Review> {
        let scene = PrunedScene {
            leaves: self.parameters.leaves(),
            sh_degree: self.schedule.sh_degree(self.iteration),
            settings: self.settings,
            background: self.config.raster.background,
        };
        let mut rng = stream(self.config.seed, Purpose::Pruning, self.iteration as u64);
        let trained = self.views(self.schedule.trained(self.iteration));
        let trained = scene.judges(&evenly(&trained, MEASURED_VIEWS), &mut rng);
        let held_back = scene.judges(&self.views(self.schedule.judges()), &mut rng);
        let costs = scene.costs(&trained, &mut rng)?;
        let pruning = scene.prune(&costs, &held_back, LOSS)?;
        let every = trained.len().div_ceil(held_back.len());
        let compared: Vec<_> = trained.into_iter().step_by(every).collect();
        let review = Review {
            iteration: self.iteration,
            gaussians: costs.len(),
            kept: pruning.kept.len(),
            psnr_before: pruning.before,
            psnr_after: pruning.after,
            psnr_trained: scene.psnr(&compared, &[])?,
        };
        drop(scene);
        self.parameters.select(&pruning.kept);
        self.statistics.select(&pruning.kept);
        self.reviews.push(review);
        Ok(review)
    }

    fn views(&self, indices: &[usize]) -> Vec<&'a View> {
        indices.iter().map(|&i| self.train[i]).collect()
    }
}
