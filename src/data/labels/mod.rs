//! Labels: class tables, label maps and their cameras, masks, and the formats of raw labels.

pub(crate) mod classes;
pub(crate) mod frame_labels;
pub(crate) mod label_map;
pub(crate) mod label_runs;
pub(crate) mod map_geometry;
pub(crate) mod mask_file;
pub(crate) mod palette;
pub(crate) mod raw;
pub mod scores;
