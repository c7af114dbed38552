//! The two stages of training: building Gaussians from photos, then segmentation identities; checkpoints, progress.

pub mod train_decoder;
pub(crate) mod variants;

pub(crate) mod compactness;
pub(crate) mod given;
pub(crate) mod held_out;
pub(crate) mod pictures;
pub(crate) mod provenance;
pub(crate) mod pruned;
pub(crate) mod run;
pub(crate) mod segmentation_inputs;

pub use self::given::compare_with_photos;
pub use self::pictures::{Pictures, score_images};
pub use self::provenance::Provenance;
pub use self::pruned::Pruned;
pub use self::run::{Associated, Outcome, Seconds, load_scene, run};
pub use self::segmentation_inputs::{Inputs, Seen, Spatial};
pub use self::variants::{VariantOutcome, decoder_row};
