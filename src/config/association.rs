//! Association of label maps whose ids differ from view to view.

use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;

/// How ids of raw labels become one id per object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Association {
    /// Nothing: ids of raw labels are class ids.
    #[default]
    None,
    /// The Gaussians that the segments of the views cover.
    Gaussians,
}

/// Options of the association over Gaussians. No key sets them; tests change them.
#[derive(Clone, Debug, PartialEq, SmartDefault)]
pub struct AssociationConfig {
    /// Passes over all views; the first forms groups, the others assign every view again.
    #[default(4)]
    pub sweeps: usize,
    /// Groups with a smaller share of all labelled weight are dropped, 0 to 1.
    #[default(1e-5)]
    pub min_weight: f64,
}
