//! Tests of `coseg::viewer`.

pub mod drawing;
#[cfg(unix)]
pub mod edit_history;
#[cfg(unix)]
pub mod mends;
pub mod page;
#[cfg(unix)]
pub mod panel;
#[cfg(unix)]
pub mod points;
#[cfg(all(unix, feature = "serve"))]
pub mod served;
pub mod viewer_edits;
