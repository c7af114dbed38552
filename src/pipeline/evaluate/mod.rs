//! Scores of a run: held-out pictures and label maps.

mod held_out;
mod pictures;

pub use self::held_out::{HeldOut, HeldOutScores};
pub use self::pictures::{Pictures, score_images};
