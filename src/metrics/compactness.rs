//! How compact identities are.

use serde::{Deserialize, Serialize};

/// How compact the identities of a variant are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Compactness {
    /// Share of the pairs of a Gaussian and one of its nearest neighbours whose labels differ, 0..1.
    pub neighbours_differ: f64,
}

/// How far the raw labels agree about each Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Mean Shannon entropy of the votes of a Gaussian that has some, nats.
    pub entropy: f64,
    /// Share of these Gaussians whose winner has less than two thirds of the votes, 0..1.
    pub contested: f64,
}
