//! Scores of a run: held-out pictures, label maps and rendered features.

mod feature_field;
mod held_out;
mod pictures;

pub use self::feature_field::FieldScores;
pub use self::held_out::{HeldOut, HeldOutScores};
pub use self::pictures::{Pictures, score_images};
