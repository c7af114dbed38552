//! The nested point sets of an encoder: random sampling, neighbours, and the way back up.

use super::interpolation::interpolation;
use super::neighbours::{Neighbours, PointIndex};
use crate::error::Result;
use crate::ops::SparseMatrix;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Samplings of an encoder, one after each of its layers; the decoder has as many upsamplings.
pub const LAYERS: usize = 4;
/// Neighbours a point, itself included.
pub const NEIGHBOURS: usize = 16;
/// Each sampling keeps one point in this many.
pub const RATIO: usize = 4;
/// Purpose of the random stream that shuffles points, see [`Hierarchy::build`].
const SHUFFLE_STREAM: u64 = 0x7261_6e64;

/// One point set of a [`Hierarchy`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SampledLevel {
    /// `[N_n]` rows of the encoded cloud.
    pub indices: Vec<u32>,
    /// `[N_n, 3]` positions, in the unit the encoder is given.
    pub positions: Vec<[f32; 3]>,
    /// `[N_n, K]` nearest points of this level, itself first.
    pub neighbours: Neighbours,
    /// `[N_(n+1)]` rows of this level that the next one keeps.
    pub kept: Vec<u32>,
}

/// Point sets from fine to coarse, level n + 1 a random quarter of level n.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hierarchy {
    /// Levels 1 to L: where features are computed. Level 1 is the cloud in its own order.
    pub levels: Vec<SampledLevel>,
    /// Rows of the cloud in the last sampled set.
    pub coarsest_indices: Vec<u32>,
    /// Positions of the last sampled set.
    pub coarsest_positions: Vec<[f32; 3]>,
}

impl Hierarchy {
    /// Samples `positions` (`[N, 3]`) `layers` times: each next level keeps the first quarter (at least one point, see
    /// [`RATIO`]) of one seeded shuffle. Sets smaller than [`NEIGHBOURS`] repeat their neighbours.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming the first bad row.
    pub fn build(positions: &[[f32; 3]], layers: usize, seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(SHUFFLE_STREAM);
        let mut order: Vec<u32> = (0..positions.len() as u32).collect();
        order.shuffle(&mut rng);
        let mut indices: Vec<u32> = (0..positions.len() as u32).collect();
        let mut levels = Vec::with_capacity(layers);
        for n in 0..layers {
            let points: Vec<[f32; 3]> = indices.iter().map(|&i| positions[i as usize]).collect();
            let neighbours = PointIndex::new(&points)?.neighbours(NEIGHBOURS);
            let count = (points.len() / RATIO).max(1).min(points.len());
            order.truncate(count);
            // from level 2 on, the rows already are the shuffle's first ones
            let kept = if n == 0 {
                order.clone()
            } else {
                (0..count as u32).collect()
            };
            levels.push(SampledLevel {
                indices,
                positions: points,
                neighbours,
                kept,
            });
            indices = order.clone();
        }
        let coarsest_positions = indices.iter().map(|&i| positions[i as usize]).collect();
        Ok(Self {
            levels,
            coarsest_indices: indices,
            coarsest_positions,
        })
    }

    /// The maps that carry features from level n + 1 (or the coarsest set) to level n, for n = 1 to L.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming the first bad row.
    pub fn upsampling(&self) -> Result<Vec<Arc<SparseMatrix>>> {
        let coarser = self
            .levels
            .iter()
            .skip(1)
            .map(|l| &l.positions)
            .chain([&self.coarsest_positions]);
        let pairs = self.levels.iter().zip(coarser);
        pairs
            .map(|(fine, coarse)| Ok(Arc::new(interpolation(coarse, &fine.positions)?)))
            .collect()
    }
}
