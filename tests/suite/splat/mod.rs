//! Tests of `coseg::splat`.

pub mod camera;
pub mod camera_paths;
pub mod level;
pub mod orbits;
pub mod ply;
pub mod properties;
