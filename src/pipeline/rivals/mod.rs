//! Methods of other papers, on the Gaussians, features, labels and pixels that ours are trained on. Geometry and colours stay frozen,
//! where the originals train them together with the labels.

mod feature_field;
mod grouping;
mod panoptic_lifting;

pub use self::feature_field::{LinearHead, distil};
pub use self::grouping::{Codes, Grouping};
pub use self::panoptic_lifting::PanopticLifting;

use super::segmentation_inputs::SegmentationInputs;
use crate::random::{Purpose, stream};
use rand_chacha::ChaCha8Rng;

/// The random numbers of initial parameters.
fn initial_parameters(inputs: &SegmentationInputs) -> ChaCha8Rng {
    stream(inputs.config.seed, Purpose::RivalParameters, 0)
}
