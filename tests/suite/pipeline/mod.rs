//! Tests of `coseg::pipeline`.

pub mod checkpoint;
#[cfg(feature = "wgpu")]
pub mod device_stage_two;
pub mod feature_field;
pub mod initial_scene;
#[cfg(unix)]
pub mod interrupt;
pub mod provenance;
pub mod query;
pub mod resume;
pub mod rivals;
pub mod rows;
pub mod run_folder;
#[cfg(target_os = "linux")]
pub mod soak;
pub mod stage_two;
pub mod stops;
