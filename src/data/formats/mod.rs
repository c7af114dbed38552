//! Scene folders: the layouts that are read, and what they have in common.

pub(crate) mod camera_file;
pub(crate) mod colmap;
pub(crate) mod depth;
pub(crate) mod frame;
pub(crate) mod layout;
pub(crate) mod listing;
pub(crate) mod manifest;
pub(crate) mod ply;
pub(crate) mod points;
pub(crate) mod replica;
pub(crate) mod scannet;
pub(crate) mod sequence;
pub mod transforms;
