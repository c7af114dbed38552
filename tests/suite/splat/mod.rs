//! Tests of `coseg::splat`.

pub mod camera;
pub mod camera_paths;
pub mod formats;
pub mod glb;
pub mod level;
pub mod orbits;
pub mod ply;
pub mod ply_refused;
pub mod point_clouds;
pub mod properties;
pub mod sog;
pub mod splat_transform;
