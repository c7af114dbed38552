//! Tests of `coseg::reconstruction`.

pub mod densify;
pub mod masked_training;
pub mod mcmc;
pub mod relocation;
pub mod settings;
pub mod trainer;
#[cfg(feature = "wgpu")]
pub mod trainer_on_gpu;
