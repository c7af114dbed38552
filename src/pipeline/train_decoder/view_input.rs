//! The decoder's frozen input for one training view: parts of the pyramid, and neighbours for the 3D regularisation.

use super::decoder_model::{DecoderPlan, Encoded};
use crate::error::Result;
use crate::random::{Purpose, stream};
use crate::segmentation::loss::NeighbourPairs;
use crate::segmentation::neighbours::without_self;
use crate::segmentation::pyramid::{Dependencies, Pyramid};
use std::ops::Range;

/// Scales of the 3D regularisation (n = 3, 4), zero-based.
pub(super) const REGULARISED: [usize; 2] = [2, 3];

/// Frozen, so it is computed once for each view and kept where memory allows.
#[derive(Clone, Debug)]
pub(super) struct ViewInput {
    /// The view's visible Gaussians in order, in parts that are decoded at once.
    pub parts: Vec<Part>,
    /// The points of the regularised scales that all parts together depend on.
    pub clouds: [Cloud; REGULARISED.len()],
}

/// Gaussians that are decoded together.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// Their places among the visible Gaussians.
    pub places: Range<usize>,
    /// Their numbers in the scene.
    pub gaussians: Vec<u32>,
    /// The rows of the pyramid that they depend on.
    pub rows: Dependencies,
    /// Those rows, where memory allows.
    pub pyramid: Option<Pyramid>,
}

impl Part {
    /// The part of the encoding's pyramid `whole` that these Gaussians depend on.
    pub fn pyramid(&self, whole: &Pyramid) -> Pyramid {
        match &self.pyramid {
            Some(pyramid) => pyramid.clone(),
            None => whole.part(&self.rows),
        }
    }
}

/// Points of a regularised scale.
#[derive(Clone, Debug, Default)]
pub(super) struct Cloud {
    /// Rows of the pyramid's level, ascending.
    pub rows: Vec<u32>,
    /// The K nearest others of each point, `[N_n, K]`, as places in `rows`; empty without regularisation.
    neighbours: Vec<u32>,
}

impl ViewInput {
    /// The input for the Gaussians `visible` of `encoded`, in parts of `plan.config.decoder_chunk`. `means` are the centres of
    /// all Gaussians of the scene.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming a centre.
    pub fn new(
        encoded: &Encoded,
        visible: &[u32],
        means: &[[f32; 3]],
        plan: &DecoderPlan,
    ) -> Result<Self> {
        let row = |g: &u32| encoded.points.binary_search(g).ok().map(|row| row as u32);
        let rows: Vec<u32> = visible.iter().filter_map(row).collect();
        let size = match plan.config.decoder_chunk {
            0 => rows.len().max(1),
            // Parts of one size instead of a small one at the end.
            chunk => rows
                .len()
                .div_ceil(rows.len().div_ceil(chunk).max(1))
                .max(1),
        };
        let part = |start: usize| {
            let places = start..(start + size).min(rows.len());
            Part {
                gaussians: visible[places.clone()].to_vec(),
                rows: Dependencies::new(&encoded.pyramid, rows[places.clone()].to_vec()),
                pyramid: None,
                places,
            }
        };
        let parts: Vec<Part> = (0..rows.len().max(1)).step_by(size).map(part).collect();
        let mut clouds = [Cloud::default(), Cloud::default()];
        if plan.regularised {
            for (cloud, scale) in clouds.iter_mut().zip(REGULARISED) {
                if scale < encoded.pyramid.levels.len() {
                    *cloud = Cloud::new(encoded, &parts, scale, means, plan)?;
                }
            }
        }
        Ok(Self { parts, clouds })
    }

    /// Gathers the parts of `whole` once, if they fit in `budget` bytes.
    pub fn gather(&mut self, whole: &Pyramid, budget: usize) {
        let mut left = budget;
        for part in &mut self.parts {
            let pyramid = whole.part(&part.rows);
            match left.checked_sub(pyramid.bytes()) {
                Some(rest) => left = rest,
                None => return,
            }
            part.pyramid = Some(pyramid);
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let clouds = self.clouds.iter();
        let clouds = clouds.map(|cloud| 4 * (cloud.rows.len() + cloud.neighbours.len()));
        let parts = self.parts.iter().map(|part| {
            let gathered = part.pyramid.as_ref().map_or(0, Pyramid::bytes);
            4 * part.gaussians.len() + part.rows.bytes() + gathered
        });
        parts.chain(clouds).sum()
    }
}

impl Cloud {
    fn new(
        encoded: &Encoded,
        parts: &[Part],
        scale: usize,
        means: &[[f32; 3]],
        plan: &DecoderPlan,
    ) -> Result<Self> {
        let rows = parts.iter().flat_map(|part| part.rows.rows(scale));
        let mut rows: Vec<u32> = rows.copied().collect();
        rows.sort_unstable();
        rows.dedup();
        let points = &encoded.pyramid.levels[scale].points;
        let centre = |&r: &u32| means[encoded.points[points[r as usize] as usize] as usize];
        let centres: Vec<[f32; 3]> = rows.iter().map(centre).collect();
        let neighbours = without_self(&centres, plan.config.reg_neighbours)?;
        Ok(Self { rows, neighbours })
    }

    /// The sampled points of `iteration` at `scale` with their neighbours, as places in [`Cloud::rows`].
    pub fn sample(
        &self,
        plan: &DecoderPlan,
        scale: usize,
        iteration: usize,
    ) -> Option<NeighbourPairs> {
        let (points, k) = (self.rows.len(), plan.config.reg_neighbours);
        if self.neighbours.len() != points * k || points < 2 {
            return None;
        }
        let index = (iteration * 4 + scale) as u64;
        let mut rng = stream(plan.seed, Purpose::Regularisation, index);
        let count = plan.config.reg_samples.min(points);
        let chosen = rand::seq::index::sample(&mut rng, points, count);
        let chosen = chosen.iter().map(|i| i as u32).collect();
        Some(NeighbourPairs::new(chosen, &self.neighbours, k))
    }
}
