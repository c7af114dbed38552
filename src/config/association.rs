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
