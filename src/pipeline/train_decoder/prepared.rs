//! What a step of the decoder needs of a view besides its weights: which parts of the pyramid, and which neighbours.

use super::fused::{Encoded, FusedPlan};
use crate::error::Result;
use crate::ops::NeighbourPairs;
use crate::random::{Purpose, stream};
use crate::segmentation::neighbours::without_self;
use crate::segmentation::pyramid::{Restriction, Rows};
use std::ops::Range;
use std::sync::Arc;

/// Scales of the 3D regularisation (n = 3, 4), zero-based.
pub(crate) const REGULARISED: [usize; 2] = [2, 3];

/// Sampled points of each regularised scale with their neighbours, as positions in [`Cloud::rows`]; absent without any.
pub(crate) type Sampled = Vec<Option<NeighbourPairs>>;

/// Frozen, so it is made once a view and kept where memory allows.
#[derive(Clone, Debug)]
pub(crate) struct Prepared {
    /// The view's visible Gaussians in order, as many together as are decoded at once.
    pub parts: Vec<Part>,
    /// What of the regularised scales all of them depend on.
    pub clouds: [Cloud; REGULARISED.len()],
}

/// Gaussians that are decoded together.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Which of the visible Gaussians.
    pub rows: Range<usize>,
    /// These, by their numbers in the scene.
    pub gaussians: Rows,
    /// The part of the pyramid that they depend on.
    pub kept: Restriction,
}

/// Points of a regularised scale.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cloud {
    /// Rows of the pyramid's level, ascending.
    pub rows: Rows,
    /// The K nearest others of each, `[N_n, K]`, as positions in `rows`; empty where nothing is regularised.
    neighbours: Vec<u32>,
}

impl Prepared {
    /// Of the Gaussians `visible`, of `encoded`, in parts of `plan.config.decoder_chunk`. `means` are the centres of all
    /// Gaussians of the scene.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming a centre.
    pub fn new(
        encoded: &Encoded,
        visible: &[u32],
        means: &[[f32; 3]],
        plan: &FusedPlan,
    ) -> Result<Self> {
        let row = |g: &u32| encoded.points.binary_search(g).ok().map(|row| row as u32);
        let rows: Vec<u32> = visible.iter().filter_map(row).collect();
        let of = |rows: Range<usize>, finest: Vec<u32>| Part {
            gaussians: Arc::new(visible[rows.clone()].to_vec().into()),
            kept: Restriction::new(&encoded.pyramid, Arc::new(finest.into())),
            rows,
        };
        let parts: Vec<Part> = match plan.config.decoder_chunk {
            chunk if chunk > 0 && rows.len() > chunk => {
                // Parts of one size instead of a small one at the end.
                let size = rows.len().div_ceil(rows.len().div_ceil(chunk));
                let starts = (0..rows.len()).step_by(size);
                starts
                    .zip(rows.chunks(size))
                    .map(|(at, rows)| of(at..at + rows.len(), rows.to_vec()))
                    .collect()
            }
            _ => vec![of(0..rows.len(), rows)],
        };
        let mut clouds = [Cloud::default(), Cloud::default()];
        for (cloud, scale) in clouds.iter_mut().zip(REGULARISED) {
            if let (true, Some(level)) = (plan.regularised, encoded.pyramid.levels.get(scale)) {
                cloud.rows = together(&parts, scale);
                let at =
                    |&r: &u32| means[encoded.points[level.points[r as usize] as usize] as usize];
                let centres: Vec<[f32; 3]> = cloud.rows.iter().map(at).collect();
                cloud.neighbours = without_self(&centres, plan.config.reg_neighbours)?;
            }
        }
        Ok(Self { parts, clouds })
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let clouds = self
            .clouds
            .iter()
            .map(|cloud| 4 * (cloud.rows.len() + cloud.neighbours.len()));
        self.parts
            .iter()
            .map(|part| 4 * part.gaussians.len() + part.kept.bytes())
            .chain(clouds)
            .sum()
    }
}

impl Cloud {
    /// The sampled points of `iteration` at `scale` with their neighbours, as positions in [`Cloud::rows`].
    pub fn sample(
        &self,
        plan: &FusedPlan,
        scale: usize,
        iteration: usize,
    ) -> Option<NeighbourPairs> {
        let (points, k) = (self.rows.len(), plan.config.reg_neighbours);
        if self.neighbours.len() != points * k || points < 2 {
            return None;
        }
        let mut rng = stream(
            plan.seed,
            Purpose::Regularisation,
            (iteration * 4 + scale) as u64,
        );
        let chosen =
            rand::seq::index::sample(&mut rng, points, plan.config.reg_samples.min(points));
        let chosen = chosen.iter().map(|i| i as u32).collect();
        Some(NeighbourPairs::new(chosen, &self.neighbours, k))
    }
}

/// The rows of level `scale` that some part depends on, ascending.
fn together(parts: &[Part], scale: usize) -> Rows {
    let mut rows = parts.iter().filter_map(|part| part.kept.rows(scale));
    match (rows.next(), rows.next()) {
        (Some(first), None) => first.clone(),
        (None, _) => Rows::default(),
        (Some(_), Some(_)) => {
            let rows = parts.iter().filter_map(|part| part.kept.rows(scale));
            let mut all: Vec<u32> = rows.flat_map(|rows| rows.iter().copied()).collect();
            all.sort_unstable();
            all.dedup();
            Arc::new(all.into())
        }
    }
}
