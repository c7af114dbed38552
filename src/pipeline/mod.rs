//! The pipeline of a run, in the paper's order.
//!
//! ```text
//! photos -> reconstruct -> (associate) -> lift -> encode -> decode -> identities -> label maps and objects
//! ```
//!
//! [`run`] calls the steps in order; each has a file of its name. `load` reads the scene, `variants` trains and scores the lines
//! of the label table, `rivals` has the methods of other papers, `pictures` scores colours, `evaluate` scores label maps and
//! features, `initial_scene` reads Gaussians of another trainer, `requirements` checks what stage two needs before stage one
//! starts, `resolve` fills in settings that follow from the scene, `corrections` has labels that a person corrected,
//! `segmentation_inputs` is what all of stage two works on.

pub mod train_decoder;

mod associate;
mod corrections;
pub(crate) mod encode;
pub(crate) mod evaluate;
mod fine_tuning;
mod initial_scene;
pub(crate) mod label_evidence;
pub(crate) mod lift;
mod load;
mod pictures;
mod prune;
mod query;
mod reconstruct;
mod requirements;
mod resolve;
mod rivals;
mod run;
mod segmentation_inputs;
mod suggest;
mod variant_outcome;
pub(crate) mod variant_training;
pub(crate) mod variants;

pub use self::associate::{Associated, AssociationCounts, associate};
pub use self::corrections::{store_corrections, stored_corrections};
pub use self::encode::{Encodings, encode};
pub use self::evaluate::{FieldScores, HeldOut, HeldOutScores};
pub use self::initial_scene::compare_with_photos;
pub use self::lift::{LiftedFeatures, Pruned};
pub use self::load::load_scene;
pub use self::pictures::{Pictures, score_images};
pub use self::prune::{Keep, Pruning, prune};
pub use self::query::LiftedMaps;
pub use self::run::{Outcome, Seconds, run, run_on};
pub use self::segmentation_inputs::SegmentationInputs;
pub use self::suggest::{Suggestion, suggest};
pub use self::variant_outcome::VariantOutcome;
pub use self::variant_training::decoder_training;
