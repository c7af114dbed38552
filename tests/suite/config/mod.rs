//! Tests of `coseg::config`.

pub mod load;
