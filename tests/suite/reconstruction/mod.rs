//! Tests of `coseg::reconstruction`.

pub mod capacity;
pub mod densify;
pub mod hard_scenes;
pub mod initial_points;
pub mod masked_training;
pub mod settings;
pub mod trainer;
#[cfg(feature = "wgpu")]
pub mod trainer_on_gpu;
