//! Tests of `coseg::viewer`.

#[cfg(unix)]
pub mod controls;
pub mod drawing;
#[cfg(unix)]
pub mod edit_history;
#[cfg(unix)]
pub mod editor;
#[cfg(unix)]
pub mod gizmo;
#[cfg(unix)]
pub mod keys;
pub mod page;
#[cfg(unix)]
pub mod panel;
#[cfg(unix)]
pub mod points;
#[cfg(unix)]
pub mod room;
#[cfg(unix)]
pub mod selections;
#[cfg(all(unix, feature = "serve"))]
pub mod served;
#[cfg(all(unix, feature = "serve"))]
pub mod strangers;
#[cfg(unix)]
pub mod touch;
pub mod viewer_edits;
