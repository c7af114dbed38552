//! Photos: files, decoding, lens distortion, the cache of decoded photos.

pub(crate) mod image_file;
pub(crate) mod lens;
pub(crate) mod photo;
pub(crate) mod photo_cache;

use std::path::Path;

/// Extensions of photos, in small letters.
pub(crate) const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Whether a path has one of [`EXTENSIONS`].
pub(crate) fn is_photo(path: &Path) -> bool {
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    EXTENSIONS.contains(&&*extension)
}

/// The kind of a file by its first bytes, of those kinds that get mixed up.
pub(crate) fn file_kind(bytes: &[u8]) -> Option<&'static str> {
    let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("a PNG image"),
        [0xFF, 0xD8, 0xFF, ..] => Some("a JPEG image"),
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => Some("a PLY file"),
        _ => matches!(first, Some(b'{' | b'[')).then_some("JSON"),
    }
}
