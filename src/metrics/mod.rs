//! Scores: PSNR, SSIM, mIoU, boundary IoU and accuracy of label maps, association accuracy and panoptic
//! quality of instance maps, also by class, Calinski-Harabasz and Davies-Bouldin of clusterings.
//!
//! No score is ever NaN: if there is nothing to score, the answer is `None`.

mod assignment;
mod boundary;
mod clusters;
mod image;
mod instances;
mod labels;
mod semantic;

pub use self::assignment::assignment;
pub use self::boundary::boundary_iou;
pub use self::clusters::{calinski_harabasz, davies_bouldin};
pub(crate) use self::image::masked_psnr;
pub use self::image::{ImageScores, PSNR_CAP, psnr, ssim};
pub use self::instances::{InstanceScores, PanopticQuality, Quality, instance_scores};
pub use self::labels::{Confusion, LabelScores, PixelScores, Void, label_scores};
pub use self::semantic::{ClassIou, PanopticScores, SemanticScores, SemanticView, semantic_scores};

/// Mean of the values that are there; `None` when there are none.
pub(crate) fn mean(values: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let (sum, n) = values
        .into_iter()
        .flatten()
        .fold((0.0, 0_usize), |(sum, n), v| (sum + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}
