//! Scene folders: the layouts that are read, and what they share.
//!
//! `layout::list` finds the layout of a folder and asks its module for a `listing::Listing`: frames with cameras,
//! photos and label files, and the initial cloud. `listing::Listing::load` makes the scene from it, the same way for all.
//! Nothing here knows the diagnostics.

pub(crate) mod block;
pub(crate) mod camera_checks;
pub(crate) mod camera_file;
pub(crate) mod colmap;
pub(crate) mod dataparser;
pub(crate) mod decode;
pub(crate) mod depth;
pub(crate) mod folder;
pub(crate) mod frame;
pub(crate) mod frame_labels;
pub(crate) mod label_folder;
pub(crate) mod layout;
pub(crate) mod listing;
pub(crate) mod mask_file;
pub(crate) mod points;
pub(crate) mod replica;
pub(crate) mod scannet;
pub(crate) mod sequence;
pub(crate) mod side_folders;
pub mod transforms;
mod unread_labels;
