//! Files that are either the old one or the whole new one: written under a temporary name, synced, renamed.

use crate::error::{Error, Result};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Writes `path` through `fill`; what stood there before stays until the new file is complete and on disk.
///
/// Missing parent folders are made. The temporary file lies in the same folder, starts with a dot and is removed when
/// anything fails.
///
/// # Errors
/// [`Error::Io`] naming `path` and the step that failed.
pub fn write(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create folder", e))?;
    let temporary = temporary_name(parent, path)?;
    let outcome = write_synced(&temporary, fill).and_then(|()| {
        fs::rename(&temporary, path).map_err(|e| Error::io(path, "rename into place", e))?;
        sync_folder(parent)
    });
    if outcome.is_err() {
        // The first error is the one worth reporting.
        let _ = fs::remove_file(&temporary);
    }
    outcome.map_err(|e| match e {
        Error::Io { action, source, .. } => Error::io(path, action, source),
        other => other,
    })
}

/// Writes `bytes` to `path` as [`write()`] does.
///
/// # Errors
/// As [`write()`].
pub fn write_bytes(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    write(path, |out| out.write_all(bytes))
}

/// A name no other writer of this or another process uses.
fn temporary_name(parent: &Path, path: &Path) -> Result<PathBuf> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let Some(name) = path.file_name() else {
        return Err(Error::io(
            path,
            "create",
            io::Error::new(io::ErrorKind::InvalidInput, "not a file name"),
        ));
    };
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(
        ".{}-{}.tmp",
        std::process::id(),
        COUNTER.fetch_add(1, Ordering::Relaxed)
    ));
    Ok(parent.join(hidden))
}

fn write_synced(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut out = BufWriter::with_capacity(1 << 20, file);
    fill(&mut out)
        .and_then(|()| out.flush())
        .map_err(|e| Error::io(path, "write", e))?;
    out.get_ref()
        .sync_all()
        .map_err(|e| Error::io(path, "sync", e))
}

/// The rename itself is on disk only once the folder is.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> Result<()> {
    File::open(folder)
        .and_then(|f| f.sync_all())
        .map_err(|e| Error::io(folder, "sync", e))
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> Result<()> {
    Ok(())
}

/// Removes the file at `path`, if there is one.
///
/// # Errors
/// [`Error::Io`] naming `path`.
pub fn remove(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(Error::io(path, "remove", error))
        }
        _ => Ok(()),
    }
}

/// Whether two names are of one file that is there: what is read must not be written over.
pub fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
