//! Scores of a run: held-out pictures and label maps.

mod held_out;
mod pictures;

pub(crate) use self::held_out::{HeldOut, Scores};
pub use self::pictures::{Pictures, score_images};
