//! Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.

pub mod bench;
pub mod camera;
pub mod config;
pub mod data;
pub mod device;
pub mod error;
pub mod features;
pub mod gaussians;
#[cfg(feature = "cube")]
mod gpu;
pub mod metrics;
pub mod objects;
pub mod ops;
pub mod random;
pub mod raster;
pub mod report;
pub mod segmentation;
pub mod train;
pub mod weights;

pub use error::{Error, Result};
