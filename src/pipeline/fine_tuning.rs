//! The last step of a decoder variant: each Gaussian corrects what the decoder gave it by the raw labels in its own pixels.
//!
//! A decoder gives Gaussians with similar features the same label. That corrects wrong labels, but loses details that only the
//! labels of a Gaussian itself show. So the scores of every Gaussian become free parameters, and learn the raw labels in one step
//! for each training view, at least 100. That is enough to move a boundary where all views agree, and too little to learn errors
//! that last. Where errors repeat from view to view and prefer frequent classes, nothing is fine-tuned.

use super::train_decoder::TrainingPlan;
use crate::segmentation::loss::LabelLoss;

/// Steps, at least.
const STEPS: usize = 100;
/// Sum of the learning rates of all steps, which bounds how far Adam moves a score. Scores of classes that have nothing in their
/// favour begin 6.2 below those of certain ones: more would turn certain Gaussians too.
const REACH: f64 = 5.0;

/// How scores are fine-tuned after training by `plan` on `views` training views: by cross-entropy on raw labels at a constant
/// learning rate, which is returned too.
pub(super) fn fine_tuning(plan: &TrainingPlan, views: usize) -> (TrainingPlan, f64) {
    let iterations = views.max(STEPS);
    let mut plan = TrainingPlan {
        loss: LabelLoss::Ce,
        warmup: 0,
        least_recall: 0.0,
        ..plan.clone()
    };
    plan.config.iterations = iterations;
    plan.config.lr_decay = false;
    // A step of a batch has a rate that is larger by its root.
    let batch = plan.config.batch();
    let reach_of_rate = iterations.div_ceil(batch) as f64 * (batch as f64).sqrt();
    (plan, REACH / reach_of_rate)
}
