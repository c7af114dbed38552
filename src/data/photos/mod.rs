//! Photos: files, decoding, lens distortion, the cache of decoded photos.

pub(crate) mod image_file;
pub(crate) mod lens;
pub(crate) mod photo;

use crate::files::extension;
use std::path::Path;

/// Extensions of photos, in lower case.
pub(crate) const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Whether a path has one of [`EXTENSIONS`].
pub(crate) fn is_photo(path: &Path) -> bool {
    EXTENSIONS.contains(&&*extension(path))
}

/// Whether a path has the extension of a HEIC photo.
pub(crate) fn is_heic(path: &Path) -> bool {
    ["heic", "heif"].contains(&&*extension(path))
}

/// What to do with HEIC photos.
pub(crate) const HEIC_HELP: &str =
    "convert them to JPEG, for instance by ImageMagick: mogrify -format jpg *.HEIC";

/// Whether a path has the extension of a video.
pub(crate) fn is_video(path: &Path) -> bool {
    ["mp4", "mov", "m4v", "mkv", "avi", "webm", "mts"].contains(&&*extension(path))
}
