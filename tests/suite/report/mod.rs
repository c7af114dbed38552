//! Tests of `coseg::report`.

mod page;
pub mod results;
mod sheet;
