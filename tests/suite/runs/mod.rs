//! Tests of `coseg::runs`.

pub mod merge;
