//! Selection of one thing by a few of its Gaussians: it grows over the tree of [`Regions`].

use super::inventory::shares_of_pixel;
use super::regions::Regions;
use crate::data::first_largest;
use crate::raster::Projected;
use crate::splat::rows_where;
use std::collections::BTreeSet;

/// Least coverage of a pixel that shows a Gaussian.
const MIN_COVERAGE: f32 = 0.5;

/// How far a selection grows from its seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Growth {
    /// The smallest threshold at which each Gaussian belongs to the selection, `[N]`, 0 or more; infinity where nothing connects it
    /// with a seed.
    pub thresholds: Vec<f32>,
    /// The threshold that is proposed.
    pub proposed: f32,
}

impl Growth {
    /// Grows a selection from the Gaussians `seeds`, at least one. It proposes the height of the region that stands out most of
    /// those that hold all seeds and at most half of the scene, or else of the smallest that holds them all. For seeds that
    /// nothing connects, it proposes the largest height that one seed proposes alone.
    ///
    /// # Panics
    /// If there is no seed, or one is not below N.
    pub fn new(regions: &Regions, seeds: &[u32]) -> Self {
        assert!(!seeds.is_empty(), "a selection grows from a seed");
        let superpoints = &regions.superpoints.of;
        let seeds = seeds.iter().map(|&seed| superpoints[seed as usize]);
        let seeds: Vec<u32> = seeds.collect();
        let reached = regions.reached(&seeds);
        Self {
            proposed: regions.propose(&seeds),
            thresholds: superpoints.iter().map(|&s| reached[s as usize]).collect(),
        }
    }

    /// The Gaussians that belong to the selection at `threshold`, ascending.
    pub fn rows(&self, threshold: f32) -> Vec<u32> {
        rows_where(&self.thresholds, |needed| {
            needed.is_finite() && *needed <= threshold
        })
    }
}

impl Regions {
    /// The regions that hold a region, from itself up.
    fn around(&self, region: u32) -> impl Iterator<Item = u32> {
        let parent = |&region: &u32| {
            let parent = self.parents[region as usize];
            (parent != region).then_some(parent)
        };
        std::iter::successors(Some(region), parent)
    }

    /// The height at which each region is in one region with one of `seeds`, `[R]`.
    fn reached(&self, seeds: &[u32]) -> Vec<f32> {
        let mut reached = vec![f32::INFINITY; self.parents.len()];
        for region in seeds.iter().flat_map(|&seed| self.around(seed)) {
            reached[region as usize] = self.heights[region as usize];
        }
        // Parents come after their parts.
        for (region, &parent) in self.parents.iter().enumerate().rev() {
            reached[region] = reached[region].min(reached[parent as usize]);
        }
        reached
    }

    fn propose(&self, seeds: &[u32]) -> f32 {
        let ancestors: Vec<BTreeSet<u32>> = seeds
            .iter()
            .map(|&seed| self.around(seed).collect())
            .collect();
        let shared = ancestors[0].iter().copied();
        let shared: Vec<u32> = shared
            .filter(|region| ancestors.iter().all(|regions| regions.contains(region)))
            .collect();
        let prominences = shared
            .iter()
            .map(|&region| self.prominences[region as usize]);
        let Some(best) = first_largest(prominences) else {
            let alone = seeds.iter().map(|&seed| self.propose(&[seed]));
            return alone.fold(0.0, f32::max);
        };
        self.heights[shared[best] as usize]
    }
}

/// The Gaussian that contributes most to the pixel (column, row) of the image of `projected`. None where the Gaussians cover less
/// than half of it.
///
/// # Panics
/// If the pixel is outside the image.
pub fn seed(pixel: [usize; 2], projected: &Projected<f32>) -> Option<u32> {
    let shares = shares_of_pixel(projected, pixel);
    let covered: f32 = shares.iter().map(|(_, share)| share).sum();
    let most = shares
        .into_iter()
        .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    most.filter(|_| covered >= MIN_COVERAGE).map(|(row, _)| row)
}
