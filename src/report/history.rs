//! Measurements during training, as plain data that a checkpoint can store.

use crate::config::Variant;
use crate::progress::Review;
use serde::{Deserialize, Serialize};

/// One measurement: iteration and value.
pub type Sample = (usize, f64);

/// Measurements of both stages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Stage one.
    pub building: BuildingHistory,
    /// Stage two, one entry for each trained variant.
    pub rows: Vec<VariantHistory>,
}

/// Measurements of the building stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BuildingHistory {
    /// Training loss.
    pub loss: Vec<Sample>,
    /// Held-out PSNR, dB.
    pub psnr: Vec<Sample>,
    /// Held-out SSIM.
    pub ssim: Vec<Sample>,
    /// Number of Gaussians.
    pub gaussians: Vec<Sample>,
    /// Reviews of that number, with `building.max_gaussians = "auto"`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reviews: Vec<Review>,
}

/// Measurements of one variant of stage two.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantHistory {
    /// The variant.
    #[serde(rename = "row")]
    pub variant: Variant,
    /// Training loss.
    pub loss: Vec<Sample>,
    /// Held-out mIoU, pooled, 0..1.
    pub miou: Vec<Sample>,
}
