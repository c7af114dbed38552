//! Tests of `coseg::config`.

pub mod load;
pub mod refused;
