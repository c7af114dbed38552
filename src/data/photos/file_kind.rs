//! Which of the kinds of files that get mixed up a file is.

/// The kind by the first bytes, where it is one of those.
pub(crate) fn by_first_bytes(bytes: &[u8]) -> Option<&'static str> {
    let kinds: [(&[u8], &str); 4] = [
        (b"\x89PNG", "a PNG image"),
        (b"\xFF\xD8\xFF", "a JPEG image"),
        (b"ply\n", "a PLY file"),
        (b"ply\r", "a PLY file"),
    ];
    let kind = kinds
        .into_iter()
        .find(|(start, _)| bytes.starts_with(start))
        .map(|(_, kind)| kind);
    let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
    kind.or_else(|| matches!(first, Some(b'{' | b'[')).then_some("JSON"))
}
