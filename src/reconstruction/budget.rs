//! `building.max_gaussians = "auto"`: the scene decides how many Gaussians it gets.
//!
//! Some training views are held back for three quarters of the run. Before each reset of opacities, and a few times after
//! densification has ended, a review leaves out the Gaussians that the held-back views hardly miss. Growth ends when the views that
//! are trained on are reproduced much better than those held back: from then on more Gaussians would learn single photos, not the
//! scene. With fewer than twelve training views none is held back, and the reviews ask all of them.

use super::Trainer;
use super::pruning::PrunedScene;
use crate::config::Budget;
use crate::data::View;
use crate::error::Result;
use crate::progress::Review;
use crate::random::{Purpose, stream};
use rand::Rng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;

/// The PSNR of held-back views that a review may take, dB. Training continues afterwards and wins it back.
const LOSS: f64 = 0.05;
/// Growth ends when the PSNR of views that are trained on is this far above that of held-back ones, dB.
pub(crate) const MAX_GAP: f64 = 3.0;
/// Training views that a review measures the Gaussians in, at most.
const MEASURED_VIEWS: usize = 96;

impl<'a> Trainer<'a> {
    /// No more Gaussians than this after a densification.
    pub(super) fn capacity(&self) -> usize {
        match self.config.building.max_gaussians {
            Budget::Unlimited => usize::MAX,
            Budget::AtMost(limit) => limit,
            Budget::Auto => {
                let learns_photos = self.reviews.iter().any(Review::learns_photos);
                let has_ended = learns_photos || !self.schedule.grows(self.iteration);
                let last = self.reviews.last().filter(|_| has_ended);
                last.map_or(usize::MAX, |review| review.kept)
            }
        }
    }

    /// Leaves out what the held-back views do not miss.
    pub(super) fn review(&mut self) -> Result<Review> {
        let mut rng = stream(self.config.seed, Purpose::Pruning, self.iteration as u64);
        let sh_degree = self.schedule.sh_degree(self.iteration);
        let scene = PrunedScene {
            leaves: self.parameters.leaves(sh_degree),
            settings: self.settings,
            background: self.background_of_reviews(&mut rng),
        };
        let trained = self.views(self.schedule.trained(self.iteration));
        let count = trained.len().min(MEASURED_VIEWS);
        let measured: Vec<&View> = sample(&mut rng, trained.len(), count)
            .into_iter()
            .map(|i| trained[i])
            .collect();
        let mut costs = scene.costs(&measured, &mut rng)?;
        if measured.len() < trained.len() {
            // Other views may show what none of these do.
            let unseen = costs.iter_mut().filter(|cost| **cost == 0.0);
            unseen.for_each(|cost| *cost = f64::INFINITY);
        }
        let held_back = self.views(self.schedule.judges());
        let before = scene.psnr(&held_back, &[])?;
        let kept = scene.prune(&costs, &held_back, before - LOSS, costs.len())?;
        let psnr_trained = scene.psnr(&measured, &[])?;
        self.parameters.select(&kept);
        self.statistics.select(&kept);
        let after = PrunedScene {
            leaves: self.parameters.leaves(sh_degree),
            ..scene
        };
        let review = Review {
            iteration: self.iteration,
            gaussians: costs.len(),
            kept: kept.len(),
            psnr_before: before,
            psnr_after: after.psnr(&held_back, &[])?,
            psnr_trained,
        };
        self.reviews.push(review);
        Ok(review)
    }

    /// A random colour where training has random ones, so that surfaces of the usual colour are missed too.
    fn background_of_reviews(&self, rng: &mut ChaCha8Rng) -> [f32; 3] {
        let is_transparent = self.train.iter().any(|view| view.image.is_transparent());
        if self.config.building.random_background && !is_transparent {
            rng.random()
        } else {
            self.config.raster.background
        }
    }

    fn views(&self, indices: &[usize]) -> Vec<&'a View> {
        indices.iter().map(|&i| self.train[i]).collect()
    }
}

impl Review {
    /// Whether the views that are trained on are reproduced much better than those held back.
    pub(crate) fn learns_photos(&self) -> bool {
        self.psnr_trained > self.psnr_before + MAX_GAP
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use burn::tensor::Device;

    fn review(kept: usize, gap: f64) -> Review {
        Review {
            kept,
            psnr_before: 30.0,
            psnr_trained: 30.0 + gap,
            ..Review::default()
        }
    }

    #[test]
    fn growth_ends_for_good_where_photos_are_learned() {
        let options = BuiltinOptions {
            width: 32,
            height: 24,
            train_views: 2,
            test_views: 1,
            points: 100,
            ..BuiltinOptions::default()
        };
        let scene = scene_with(&options).expect("a scene");
        let config = Config::default();
        let mut trainer = Trainer::new(&scene, &config, &Device::ndarray()).expect("a stage");
        assert_eq!(trainer.capacity(), usize::MAX);
        trainer.reviews = vec![review(70, 2.9)];
        assert_eq!(trainer.capacity(), usize::MAX);
        trainer.reviews.push(review(50, 3.1));
        assert_eq!(trainer.capacity(), 50);
        trainer.reviews.push(review(40, 1.0));
        assert_eq!(trainer.capacity(), 40, "for good");
        trainer.reviews = vec![review(70, 2.9)];
        trainer.iteration = config.building.iterations / 2;
        assert_eq!(trainer.capacity(), 70, "densification has ended");
        trainer.config.building.max_gaussians = Budget::AtMost(9);
        assert_eq!(trainer.capacity(), 9);
    }
}
