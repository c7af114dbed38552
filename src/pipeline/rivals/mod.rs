//! Methods of other papers, on the Gaussians, features, labels and pixels that ours are trained on. Geometry and colours stay frozen,
//! where the originals train them together with the labels.

mod feature_field;
mod grouping;
mod panoptic_lifting;

pub use self::feature_field::{LinearHead, distil};
pub use self::grouping::{Codes, Grouping};
pub use self::panoptic_lifting::PanopticLifting;

use super::encode::Inputs;
use crate::random::{Purpose, stream, uniform};
use crate::segmentation::randla::parameter;
use burn::nn::Linear;
use burn::tensor::Device;
use rand_chacha::ChaCha8Rng;

/// The random numbers of first parameters.
fn first_parameters(inputs: &Inputs) -> ChaCha8Rng {
    stream(inputs.config.seed, Purpose::RivalParameters, 0)
}

/// A linear map of `inputs` to `outputs` channels with first weights uniform in +-1/sqrt(`inputs`).
fn linear(inputs: usize, outputs: usize, rng: &mut ChaCha8Rng, device: &Device) -> Linear {
    let bound = 1.0 / (inputs as f32).sqrt();
    let weight = uniform(inputs * outputs, bound, rng);
    let bias = uniform(outputs, bound, rng);
    Linear {
        weight: parameter(weight, [inputs, outputs], device),
        bias: Some(parameter(bias, [outputs], device)),
    }
}
