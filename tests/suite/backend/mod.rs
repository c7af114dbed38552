//! Tests of `coseg::backend`.

pub mod backends;
#[cfg(feature = "wgpu")]
pub mod device_training;
