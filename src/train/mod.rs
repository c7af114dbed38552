//! The two stages of training: building Gaussians from photos, then segmentation identities; checkpoints, progress.

mod building;
mod building_state;
pub mod checkpoint;
mod compactness;
mod curve;
mod given;
mod held_out;
mod parameters;
mod photos;
mod pictures;
pub mod progress;
mod provenance;
mod pruned;
mod rates;
mod rows;
mod run;
pub mod schedule;
pub mod segmentation;
mod segmentation_inputs;

pub use building::{BuildingStage, Densified, StepReport};
pub use building_state::BuildingState;
pub use given::compare_with_photos;
pub use parameters::Moments;
pub use pictures::{Pictures, score_images};
pub use provenance::Provenance;
pub use pruned::Pruned;
pub use rows::{RowOutcome, decoder_row};
pub use run::{Associated, Outcome, Seconds, load_scene, run};
pub use segmentation_inputs::{Inputs, Seen, Spatial};
