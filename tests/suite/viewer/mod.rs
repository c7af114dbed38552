//! Tests of `coseg::viewer`.

pub mod viewer;
pub mod viewer_edits;
