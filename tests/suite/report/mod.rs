//! Tests of `coseg::report`.

pub mod report;
