//! Tests of `coseg::metrics`.

pub mod assignment;
pub mod boundary;
pub mod instance_metrics;
pub mod properties;
pub mod scores;
