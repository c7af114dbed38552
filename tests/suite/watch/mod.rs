//! Tests of `coseg::watch`.

#[cfg(unix)]
pub mod page;
pub mod server;
