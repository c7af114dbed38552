//! Scores of a run: held-out label maps and rendered features.

mod feature_field;
mod held_out;

pub use self::feature_field::FieldScores;
pub use self::held_out::{HeldOut, HeldOutScores};
