//! Tests of `coseg::config`.

pub mod config;
pub mod unread;
