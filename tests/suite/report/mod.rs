//! Tests of `coseg::report`.

pub mod results;
mod sheet;
