//! Tests of `coseg::cli`.

pub mod bench;
pub mod cli;
pub mod render_settings;
pub mod views;
