//! Tests of what every reader of files promises.

pub mod bit_flips;
pub mod mutations;
pub mod mutations_of_inputs;
