//! Tests of `coseg::compare`.

mod plans;
mod runs;
mod statistics;
mod tables;
