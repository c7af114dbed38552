//! Tests of `coseg::reconstruction`.

pub mod building;
pub mod building_settings;
pub mod densify;
#[cfg(feature = "wgpu")]
pub mod device_building;
pub mod masked_training;
pub mod mcmc;
pub mod relocation;
