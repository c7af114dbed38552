//! How compact the identities of the variants are.

use crate::error::Result;
use crate::metrics::Compactness;
use crate::objects::{Identities, NeighbourGraph};
use crate::pipeline::encode::Inputs;

/// The graph of nearest neighbours of a run, made once for all variants.
pub(crate) struct NeighbourAgreement(NeighbourGraph);

impl NeighbourAgreement {
    /// The graph over the Gaussians of `inputs`.
    ///
    /// # Errors
    /// Those of [`NeighbourGraph::new`].
    pub fn new(inputs: &Inputs) -> Result<Self> {
        Ok(Self(NeighbourGraph::new(&inputs.gaussians.means)?))
    }

    /// Share of the pairs of neighbours whose labels differ.
    pub fn of(&self, identities: &Identities) -> Compactness {
        Compactness {
            neighbours_differ: self.0.disagreement(identities),
        }
    }
}
