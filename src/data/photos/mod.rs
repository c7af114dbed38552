//! Photos: files, decoding, lens distortion, the cache of decoded photos.

pub(crate) mod file_kind;
pub(crate) mod image_file;
pub(crate) mod lens;
pub(crate) mod photo;
pub(crate) mod photo_cache;
