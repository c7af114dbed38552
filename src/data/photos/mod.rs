//! Photos: files, decoding, lens distortion, the cache of decoded photos.

pub(crate) mod image_file;
pub(crate) mod lens;
pub(crate) mod photo;
pub(crate) mod photo_cache;

use crate::files::extension;
use std::path::Path;

/// Extensions of photos, in small letters.
pub(crate) const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Whether a path has one of [`EXTENSIONS`].
pub(crate) fn is_photo(path: &Path) -> bool {
    EXTENSIONS.contains(&&*extension(path))
}
