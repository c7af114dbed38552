//! Tests of `coseg::segmentation`.

pub mod algorithm_one;
pub mod attendance_pruning;
pub mod blended_loss;
pub mod decoder;
pub mod decoder_chunks;
#[cfg(feature = "wgpu")]
pub mod device_unprojection;
pub mod loss;
pub mod loss_of_distributions;
pub mod masked_unprojection;
pub mod neighbours;
pub mod pretrain;
pub mod randla;
pub mod unprojection;
