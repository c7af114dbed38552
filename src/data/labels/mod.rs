//! Labels: class tables, label maps and their cameras, and the formats of raw labels. Nothing here knows the layouts of scene folders.

pub mod annotations;
pub(crate) mod classes;
pub(crate) mod label_map;
pub(crate) mod label_runs;
pub(crate) mod largest;
pub(crate) mod map_geometry;
pub(crate) mod palette;
pub(crate) mod raw;
pub mod scores;
