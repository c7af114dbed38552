//! Label maps: formats of raw labels, class tables, palettes, masks of photos.

pub(crate) mod classes;
pub(crate) mod label_map;
pub(crate) mod label_runs;
pub(crate) mod map_geometry;
pub(crate) mod mask_file;
pub(crate) mod palette;
pub(crate) mod raw;
