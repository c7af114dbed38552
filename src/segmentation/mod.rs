//! Segmentation identities: where image features meet the shape of the scene.

pub mod checkpoint;
pub mod interpolation;
pub mod neighbours;
pub mod pyramid;
pub mod randla;
