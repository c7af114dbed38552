//! How far neighbouring Gaussians disagree.

use super::Identities;
use crate::error::Result;
use crate::segmentation::neighbours::without_self;

/// Nearest neighbours of each Gaussian that its label is compared with.
const NEIGHBOURS: usize = 8;

/// The nearest neighbours of every Gaussian.
pub struct NeighbourGraph {
    /// `[N, NEIGHBOURS]`, without the Gaussian itself.
    neighbours: Vec<u32>,
}

impl NeighbourGraph {
    /// The graph of the Gaussians at `means`.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming the first bad row.
    pub fn new(means: &[[f32; 3]]) -> Result<Self> {
        let neighbours = match means {
            [] => Vec::new(),
            _ => without_self(means, NEIGHBOURS)?,
        };
        Ok(Self { neighbours })
    }

    /// Share of the labelled pairs (Gaussian, neighbour) whose labels differ, 0..1; 0 without labelled pairs.
    pub fn disagreement(&self, identities: &Identities) -> f64 {
        let labels = identities.labels();
        let mut pairs = 0_u64;
        let mut differ = 0_u64;
        for (own, row) in labels.iter().zip(self.neighbours.chunks_exact(NEIGHBOURS)) {
            let Some(own) = own else { continue };
            for other in row.iter().filter_map(|&j| labels[j as usize]) {
                pairs += 1;
                differ += u64::from(other != *own);
            }
        }
        differ as f64 / pairs.max(1) as f64
    }
}
