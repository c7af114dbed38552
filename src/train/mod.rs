//! The two stages of training: building Gaussians from photos, then segmentation identities; checkpoints, progress.

mod building;
mod building_state;
pub mod checkpoint;
mod parameters;
mod photos;
pub mod progress;
pub mod schedule;

pub use building::{BuildingStage, StepReport};
pub use building_state::BuildingState;
pub use parameters::Moments;
