//! Tests of `coseg::data`.

pub mod blender;
pub mod builtin;
pub mod camera_files;
pub mod cautions;
pub mod classes;
pub mod colmap;
pub mod colmap_models;
pub mod data_check;
pub mod drawn_labels;
pub mod lens;
pub mod map_geometry;
pub mod mask_folders;
pub mod masks;
pub mod photos;
pub mod poses;
pub mod properties;
pub mod raw_formats;
pub mod real_poses;
pub mod replica;
pub mod scannet;
pub mod splits;
pub mod transforms;
pub mod turned_photos;
