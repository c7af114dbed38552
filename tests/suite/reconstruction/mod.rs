//! Tests of `coseg::reconstruction`.

pub mod densify;
pub mod initial_points;
pub mod masked_training;
pub mod mcmc;
pub mod position_noise;
pub mod relocation;
pub mod settings;
pub mod trainer;
#[cfg(feature = "wgpu")]
pub mod trainer_on_gpu;
