//! Segmentation identities: where image features meet the shape of the scene.

pub mod decoder;
pub mod encoder;
pub mod interpolation;
pub(crate) mod linear;
pub mod loss;
pub mod neighbours;
pub mod pixels;
pub mod pyramid;
pub mod randla;
pub mod sampling;
pub mod unprojection;
