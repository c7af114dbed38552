//! What training and scoring of a variant gives.

use super::evaluate::{FieldScores, HeldOutScores};
use crate::config::Variant;
use crate::metrics::LabelScores;
use crate::objects::Identities;
use crate::progress::CurvePoint;

/// One variant, trained and scored.
#[derive(Clone, Debug)]
pub struct VariantOutcome {
    /// The variant.
    pub variant: Variant,
    /// What the Gaussians store. `None` for the raw labels themselves.
    pub identities: Option<Identities>,
    /// Held-out scores.
    pub scores: HeldOutScores,
    /// Held-out scores with void predictions left out; raw labels only.
    pub void_left_out: Option<LabelScores>,
    /// Scores of the feature field that the variant reads in all scales, if they were requested.
    pub field: Option<FieldScores>,
    /// Training curve; empty where nothing was trained.
    pub curve: Vec<CurvePoint>,
    /// Bytes of everything learned.
    pub learnable_bytes: usize,
    /// Learning rate, if any.
    pub rate: Option<f64>,
    /// Steps in which each Gaussian fine-tuned the scores of a decoder.
    pub fine_tuning_steps: Option<usize>,
    /// Seconds of training.
    pub seconds: f64,
    /// The share of them that earlier parts of a resumed run took.
    pub earlier_seconds: f64,
}

impl VariantOutcome {
    /// A variant without identities or training.
    pub(super) fn new(variant: Variant, scores: HeldOutScores) -> Self {
        Self {
            variant,
            identities: None,
            scores,
            void_left_out: None,
            field: None,
            curve: Vec::new(),
            learnable_bytes: 0,
            rate: None,
            fine_tuning_steps: None,
            seconds: 0.0,
            earlier_seconds: 0.0,
        }
    }

    /// The variant's name in settings and reports.
    pub fn name(&self) -> &'static str {
        self.variant.key()
    }
}
