//! Tests of `coseg::runs`.

pub mod merge;
pub mod names;
