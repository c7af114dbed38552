//! `metrics.json`: the figures of a run, for programs.

use super::History;
use crate::config::Variant;
use crate::memory::proc_bytes;
use crate::metrics::{ImageScores, InstanceScores, PixelScores, SemanticScores};
use crate::pipeline::{AssociationCounts, HeldOutScores, Seconds};
use crate::ranks::Traffic;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Everything measured in a run. Shares and scores are in 0..1, PSNR in dB, times in seconds, sizes in bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Name of the scene.
    pub scene: String,
    /// The command that started the run, and one for each time that it was resumed.
    #[serde(default)]
    pub commands: Vec<Command>,
    /// Gaussians in `scene.ply`.
    pub gaussians: usize,
    /// The result of association, where the settings asked for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub association: Option<AssociationCounts>,
    /// Scores on the held-out views.
    pub test: TestScores,
    /// Where the time went.
    pub seconds: Seconds,
    /// What several ranks put into sums and gathered values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ranks: Option<Traffic>,
    /// Peak resident memory of the process; `None` where the system does not report it.
    pub peak_memory_bytes: Option<u64>,
    /// Size of the learned parameters: `gaussians`, and each trained row by its name.
    pub learnable_bytes: BTreeMap<String, u64>,
    /// Where the point encoder's weights came from, such as `pretrained FILE`, `trained here` or `random`.
    pub spatial: String,
    /// Where the 2D features came from.
    pub features: String,
    /// Measurements during training.
    #[serde(default)]
    pub curves: History,
}

/// A command line and the device that it ran on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Command {
    /// Quoted for a shell.
    pub line: String,
    /// Backend and processor threads, in words.
    pub device: String,
    /// Version of this crate.
    pub version: String,
}

/// Scores on the held-out views.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TestScores {
    /// Mean of the per-image PSNR, dB; `None` without held-out views.
    pub psnr: Option<f64>,
    /// Mean of the per-image SSIM.
    pub ssim: Option<f64>,
    /// Each held-out view by its name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub views: BTreeMap<String, ImageScores>,
    /// Label scores by variant.
    pub labels: BTreeMap<Variant, VariantScores>,
}

/// Label scores of one variant.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VariantScores {
    /// `miou`, `miou_per_view` and `accuracy` of the held-out views.
    #[serde(flatten)]
    pub pixels: PixelScores,
    /// Mean boundary IoU over the same classes, all held-out views together (Cheng et al. 2021).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boundary_iou: Option<f64>,
    /// The same scores with unlabelled predictions left out instead of counted as wrong (raw labels).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub void_left_out: Option<PixelScores>,
    /// IoU by class id, pooled, for the classes in the test truth.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub class_iou: BTreeMap<u16, f64>,
    /// Scores against true instances, where association made objects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instances: Option<InstanceScores>,
    /// Scores of these objects against true classes, where their segments have classes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub semantic: Option<SemanticScores>,
    /// Views that it learned from, one for each optimiser step unless `segmentation.batch` says otherwise; for trained variants.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Learning rate, for trained variants.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learning_rate: Option<f64>,
    /// Steps in which each Gaussian fine-tuned its scores, for variants of the decoder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fine_tuning_steps: Option<usize>,
    /// Training time of this variant alone, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

impl From<&HeldOutScores> for VariantScores {
    fn from(scores: &HeldOutScores) -> Self {
        let labels = &scores.labels;
        Self {
            pixels: labels.pixels,
            boundary_iou: labels.boundary_iou,
            class_iou: labels.per_class.iter().copied().collect(),
            instances: scores.instances.clone(),
            semantic: scores.semantic.clone(),
            ..Self::default()
        }
    }
}

/// Peak resident memory of this process so far, bytes (`VmHWM`); `None` where the system does not report it.
pub fn peak_memory_bytes() -> Option<u64> {
    proc_bytes("/proc/self/status", "VmHWM:")
}
