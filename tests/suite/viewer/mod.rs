//! Tests of `coseg::viewer`.

pub mod page;
pub mod viewer_edits;
