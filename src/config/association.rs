//! Association of label maps whose ids differ from view to view.

use serde::{Deserialize, Serialize};

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

/// Options of the association over Gaussians. No key of a config file sets them.
#[derive(Clone, Debug, PartialEq)]
pub struct AssociationConfig {
    /// Passes over all views; the first forms groups, the others assign every view again.
    pub sweeps: usize,
    /// Smallest overlap (IoU of a segment and a group as the view shows it) at which the two belong together, 0 to 1.
    pub min_overlap: f64,
    /// Two groups become one when more than this share of the views that have a say put both into one segment, 0 to 1, one
    /// view that keeps them apart taken for granted; one that more than the rest of them keep apart becomes two.
    pub merge_above: f64,
    /// Groups with a smaller share of all labelled weight are dropped, 0 to 1.
    pub min_weight: f64,
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            sweeps: 4,
            min_overlap: 0.25,
            merge_above: 0.5,
            min_weight: 1e-5,
        }
    }
}
