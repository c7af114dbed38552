//! Tests of `coseg::ops`.

pub mod adam;
pub mod autodiff;
#[cfg(feature = "wgpu")]
pub mod device_ops;
pub mod photometric;
pub mod references;
