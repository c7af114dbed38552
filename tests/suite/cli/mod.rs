//! Tests of `coseg::cli`.

pub mod bench;
pub mod commands;
pub mod compare;
pub mod features;
pub mod render_settings;
pub mod views;
