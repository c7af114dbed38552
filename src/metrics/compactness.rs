//! How compact identities are.

use super::LabelScores;
use serde::{Deserialize, Serialize};

/// How compact the identities of a row are, and what diffusion changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Compactness {
    /// Share of the pairs of a Gaussian and one of its nearest neighbours whose labels differ, 0..1.
    pub neighbours_differ: f64,
    /// Figures before diffusion, where settings ask for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub without_diffusion: Option<WithoutDiffusion>,
}

/// What a row had before its identities were diffused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WithoutDiffusion {
    /// See [`Compactness::neighbours_differ`].
    pub neighbours_differ: f64,
    /// Pooled mean IoU.
    pub miou: Option<f64>,
    /// Mean IoU per view, averaged.
    pub miou_per_view: Option<f64>,
    /// Pixel accuracy.
    pub accuracy: Option<f64>,
}

impl WithoutDiffusion {
    /// Of `scores` and the share of neighbours that differ.
    pub fn new(scores: &LabelScores, neighbours_differ: f64) -> Self {
        let LabelScores {
            miou,
            miou_per_view,
            accuracy,
            ..
        } = scores;
        Self {
            neighbours_differ,
            miou: *miou,
            miou_per_view: *miou_per_view,
            accuracy: *accuracy,
        }
    }
}

/// How far the raw labels agree about each Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Mean Shannon entropy of the votes of a Gaussian that has some, nats.
    pub entropy: f64,
    /// Share of these Gaussians whose winner has less than two thirds of the votes, 0..1.
    pub contested: f64,
}
