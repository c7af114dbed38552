//! What is measured of a cell.

use crate::data::Split;
use crate::error::Result;
use crate::metrics::PixelScores;
use crate::objects::{RenderOptions, Renderer};
use crate::pipeline::{FieldScores, Outcome, VariantOutcome};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What is measured of a cell. Scores are in 0..1; `None` if there is nothing to measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// `miou`, `miou_per_view` and `accuracy` of the held-out views.
    #[serde(flatten)]
    pub pixels: PixelScores,
    /// Mean boundary IoU.
    pub boundary_iou: Option<f64>,
    /// Frames of colour and labels in a second: 1 over the median time of the held-out views.
    pub frames_per_second: Option<f64>,
    /// Bytes of everything that stage two learned.
    pub learnable_bytes: u64,
    /// Seconds of training, without those of image features.
    pub training_seconds: Option<f64>,
    /// Seconds of extracting and lifting image features, where a decoder reads them.
    pub feature_seconds: Option<f64>,
    /// Mean PSNR of the held-out views in dB, after attendance pruning.
    pub psnr: Option<f64>,
    /// Scores of the feature field that the variant reads. `None` for other variants, and in cells that earlier versions wrote.
    #[serde(default)]
    pub field: Option<FieldScores>,
    /// Gaussians after attendance pruning.
    pub gaussians: usize,
}

impl Figures {
    /// Seconds of stage two: training, and image features where the variant reads them.
    pub fn seconds(&self) -> Option<f64> {
        Some(self.training_seconds? + self.feature_seconds.unwrap_or(0.0))
    }

    /// The figures of `row`, a variant of `outcome`.
    ///
    /// # Errors
    /// As [`Renderer::frame`].
    pub(super) fn of(row: &VariantOutcome, outcome: &Outcome, device: &Device) -> Result<Self> {
        let seconds = &outcome.seconds;
        let features = seconds.features + seconds.unprojection;
        let labels = &row.scores.labels;
        let variant = row.variant;
        let decodes_features = variant.trains_decoder() && variant.reads_image_features();
        Ok(Self {
            pixels: labels.pixels,
            boundary_iou: labels.boundary_iou,
            frames_per_second: frames_per_second(row, outcome, device)?,
            learnable_bytes: row.learnable_bytes as u64,
            training_seconds: row.curve.last().map(|_| row.seconds),
            feature_seconds: decodes_features.then_some(features),
            psnr: outcome.test.psnr,
            field: row.field,
            gaussians: outcome.gaussians.len(),
        })
    }
}

/// Frames of colour and labels in a second, as `coseg render` makes them: 1 over the median time of the held-out views, after one
/// unmeasured view. `None` for a variant without identities.
fn frames_per_second(
    row: &VariantOutcome,
    outcome: &Outcome,
    device: &Device,
) -> Result<Option<f64>> {
    let Some(identities) = &row.identities else {
        return Ok(None);
    };
    let options = RenderOptions::from(&outcome.config);
    let labels = identities.ids(&outcome.scene.classes);
    let renderer = Renderer::new(outcome.gaussians.clone(), Some(labels), options, device)?;
    let views: Vec<_> = outcome.scene.split(Split::Test).collect();
    if let Some(view) = views.first() {
        renderer.frame(&view.camera)?;
    }
    let mut seconds = Vec::with_capacity(views.len());
    for view in views {
        let start = Instant::now();
        renderer.frame(&view.camera)?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    seconds.sort_unstable_by(f64::total_cmp);
    Ok(seconds.get(seconds.len() / 2).map(|median| 1.0 / median))
}
