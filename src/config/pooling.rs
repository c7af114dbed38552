//! Settings of the pooled vote.

use super::range::Range;
use crate::error::Result;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// The pooled vote: how raw labels are corrected before anything is trained. The switches are for ablations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct PoolingConfig {
    /// The votes of a view on a Gaussian are multiplied by its distance.
    #[default(true)]
    pub distance: bool,
    /// Gaussians with votes share these with the superpoints that hold them. Those without any always take what their
    /// superpoints have.
    #[default(true)]
    pub superpoints: bool,
    /// Class shares become likelihoods under a confusion matrix of the labels.
    #[default(true)]
    pub confusion: bool,
    /// Exponent of the class frequencies that votes are divided by, 0 to 1. With one, labels of any kind are pooled. Absent: it
    /// follows from the votes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exponent: Option<f64>,
}

impl PoolingConfig {
    pub(super) fn check(&self) -> Result<()> {
        match self.exponent {
            Some(exponent) => Range::Unit.check("pooling.exponent", exponent),
            None => Ok(()),
        }
    }
}
