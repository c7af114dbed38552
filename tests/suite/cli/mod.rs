//! Tests of `coseg::cli`.

#[cfg(all(feature = "wgpu", target_os = "linux"))]
pub mod adapters;
pub mod associate;
pub mod bench;
pub mod commands;
pub mod compare;
pub mod corrections;
pub mod edit;
pub mod edits;
pub mod export;
pub mod features;
#[cfg(unix)]
pub mod film;
pub mod foreign_files;
#[cfg(unix)]
pub mod from_photos;
pub mod from_photos_masks;
#[cfg(unix)]
pub mod from_photos_programs;
pub mod hostile;
pub mod prune;
pub mod query;
pub mod render;
pub mod render_annotations;
pub mod render_path;
pub mod render_settings;
pub mod select;
pub mod separate;
#[cfg(unix)]
pub mod splat_transform;
pub mod split;
pub mod train;
pub mod unused_classes;
pub mod view;
pub mod views;
