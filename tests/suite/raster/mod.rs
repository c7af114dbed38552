//! Tests of `coseg::raster`.

pub mod absgrad;
pub mod blending;
pub mod gsplat;
pub mod hard_cases;
pub mod operation_gradients;
pub mod precision;
pub mod raster_contract;
#[cfg(feature = "wgpu")]
pub mod raster_gpu;
pub mod raster_gradients;
pub mod references;
