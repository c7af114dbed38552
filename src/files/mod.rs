//! Files: read with errors that name file and line, bounded by limits, replaced safely; tables of numbers in PLY.

pub mod atomic;
mod limits;
pub mod lock;
pub mod own;
pub(crate) mod ply;

pub use self::limits::{MAX_IMAGE_PIXELS, MAX_POINTS, MAX_VIEWS};
pub(crate) use self::limits::{check_limit, check_pixels, check_points, check_views};

use crate::error::{Error, Result, bail, ensure, invalid};
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Largest text file that is read, bytes.
const MAX_TEXT_BYTES: u64 = 2 << 30;

/// Opens a file to read it. Pipes and devices are refused: they block, or have no end.
pub(crate) fn open(path: &Path) -> Result<File> {
    let failed = |e| Error::io(path, "read", e);
    let there = std::fs::metadata(path).map_err(failed)?;
    if there.is_dir() {
        return Err(failed(io::ErrorKind::IsADirectory.into()));
    }
    ensure!(there.is_file(), path, "kind"; found "a pipe or a device"; expected "a regular file";
        help "copy its content into a file");
    File::open(path).map_err(failed)
}

/// Refuses a file that is not there; `help` says what the user can do.
pub(crate) fn expect_file(path: &Path, help: &str) -> Result<()> {
    if path.is_file() {
        return Ok(());
    }
    Err(Error::missing("file", path, help))
}

/// The bytes of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = open(path)?.read_to_end(&mut bytes);
    read.map_err(|e| Error::io(path, "read", e))?;
    Ok(bytes)
}

/// The mark that programs of Windows write in front of a text in UTF-8.
const BYTE_ORDER_MARK: char = '\u{FEFF}';

/// The text of a file, without a byte order mark.
pub(crate) fn text(path: &Path) -> Result<String> {
    let file = open(path)?;
    let size = file.metadata().map_or(0, |there| there.len());
    check_limit(path, "bytes", size, MAX_TEXT_BYTES, "give a smaller file")?;
    let mut text = String::new();
    let read = file.take(MAX_TEXT_BYTES).read_to_string(&mut text);
    read.map_err(|e| Error::io(path, "read", e))?;
    text.drain(..text.len() - without_mark(&text).len());
    Ok(text)
}

/// `text` without a byte order mark.
pub(crate) fn without_mark(text: &str) -> &str {
    text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text)
}

/// The path from the root of the file system, whether or not something is there.
///
/// # Errors
/// [`Error::Io`] when the working folder is gone.
pub fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map_err(|e| Error::io(path, "find", e))
}

/// A word of a command line as a shell takes it. What is not Unicode becomes U+FFFD.
pub fn shell_word(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+".contains(c);
    if word.chars().all(is_plain) {
        word.into_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// SHA-256 of the content of a file, 64 hexadecimal digits in lower case.
///
/// # Errors
/// [`Error::Io`].
pub fn sha256(path: &Path) -> Result<String> {
    let mut file = open(path)?;
    let mut digest = Sha256::new();
    std::io::copy(&mut file, &mut digest).map_err(|e| Error::io(path, "read", e))?;
    Ok(format!("{:x}", digest.finalize()))
}

/// A JSON file; `expected` describes its form in errors.
pub(crate) fn json<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
    serde_json::from_str(&text(path)?).map_err(|e| json_error(path, &e, expected))
}

/// The TOML `text` of the file at `path`; `expected` describes its form in errors.
pub(crate) fn toml<T: DeserializeOwned>(text: &str, path: &Path, expected: &str) -> Result<T> {
    toml::from_str(text).map_err(|e: toml::de::Error| {
        let line = line_at(text, e.span().map_or(0, |span| span.start));
        invalid!(path, "line {line}"; found "{}", e.message().replace('\n', ", ");
            expected "{expected}"; help "correct the file there")
    })
}

/// The line, from 1, of the byte `offset` of a text.
pub(crate) fn line_at(text: &str, offset: usize) -> usize {
    text.bytes().take(offset).filter(|&b| b == b'\n').count() + 1
}

/// The error for JSON that does not parse.
pub(crate) fn json_error(path: &Path, e: &serde_json::Error, expected: &str) -> Error {
    invalid!(path, "line {}", e.line(); found "{e}"; expected "{expected}";
        help "correct the file there, or export it again")
}

/// The names of the files and folders in `dir` that `keep` accepts, sorted; empty where `dir` cannot be read.
pub fn names(dir: &Path, keep: impl Fn(&str, &Path) -> bool) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| Some((entry.file_name().into_string().ok()?, entry.path())))
        .filter(|(name, path)| keep(name, path))
        .map(|(name, _)| name)
        .collect();
    names.sort_unstable();
    names
}

/// The last part of a path; `None` where it has none.
pub fn file_name(path: &Path) -> Option<String> {
    Some(path.file_name()?.to_string_lossy().into_owned())
}

/// The folder that `path` is in, by a path that can be read: `.` for a bare name, whose parent is empty.
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The extension of a path in lower case; empty where it has none.
pub fn extension(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

/// Files by the number in their names.
pub(crate) type Numbered = BTreeMap<usize, PathBuf>;

/// Files of `folder` named `prefix`, a number, and one of `extensions`: `rgb_10.png` follows `rgb_9.png`.
///
/// # Errors
/// The folder cannot be read; two files have the same number.
pub(crate) fn numbered(folder: &Path, prefix: &str, extensions: &[&str]) -> Result<Numbered> {
    let mut files = Numbered::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))? {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        let digits = stem.and_then(|stem| stem.strip_prefix(prefix));
        let is_number = |digits: &&str| digits.bytes().all(|b| b.is_ascii_digit());
        let number = digits.filter(is_number).and_then(|d| d.parse().ok());
        let Some(number) = number.filter(|_| extensions.contains(&&*extension(&path))) else {
            continue;
        };
        if let Some(other) = files.insert(number, path.clone()) {
            bail!(folder, "number {number}"; found "{} and {}", other.display(), path.display();
                expected "one file for each number"; help "remove one of the two");
        }
    }
    Ok(files)
}

/// The kind of a file by its first bytes, for kinds that users confuse.
pub(crate) fn kind(bytes: &[u8]) -> Option<&'static str> {
    let first = bytes.iter().find(|byte| !byte.is_ascii_whitespace());
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("a PNG image"),
        [0xFF, 0xD8, 0xFF, ..] => Some("a JPEG image"),
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => Some("a PLY file"),
        _ => matches!(first, Some(b'{' | b'[')).then_some("JSON"),
    }
}
