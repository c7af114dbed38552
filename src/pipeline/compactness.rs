//! How compact the identities of the variants are.

use super::segmentation_inputs::Inputs;
use crate::error::Result;
use crate::metrics::Compactness;
use crate::objects::{Identities, NeighbourGraph};

/// Nearest neighbours of each Gaussian that its label is compared with.
const NEIGHBOURS: usize = 8;

/// The graph of nearest neighbours of a run, made once for all variants.
pub(crate) struct Compacting<'a>(NeighbourGraph<'a>);

impl<'a> Compacting<'a> {
    /// The graph over the Gaussians of `inputs`.
    ///
    /// # Errors
    /// Those of [`NeighbourGraph::new`].
    pub fn new(inputs: &'a Inputs) -> Result<Self> {
        Ok(Self(NeighbourGraph::new(
            &inputs.gaussians.means,
            &[],
            NEIGHBOURS,
        )?))
    }

    /// Share of the pairs of neighbours whose labels differ.
    pub fn of(&self, identities: &Identities) -> Compactness {
        Compactness {
            neighbours_differ: self.0.disagreement(identities),
        }
    }
}
