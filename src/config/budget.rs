//! How many Gaussians a scene may have.

use super::display_as_serialized;
use serde::{Deserialize, Serialize};

/// The largest number of Gaussians: a rule, or a number from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    rename_all = "lowercase",
    expecting = "expected \"auto\", \"unlimited\" or a number from 1"
)]
pub enum Budget {
    /// Held-back training views decide ([`crate::reconstruction`]).
    #[default]
    Auto,
    /// No limit: densification decides.
    Unlimited,
    /// No more than this. Larger initial clouds are thinned to it.
    #[serde(untagged)]
    AtMost(usize),
}

display_as_serialized!(Budget);

impl Budget {
    /// The number, if any.
    pub fn limit(self) -> Option<usize> {
        match self {
            Self::AtMost(limit) => Some(limit),
            Self::Auto | Self::Unlimited => None,
        }
    }
}
