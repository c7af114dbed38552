//! Atomic writes: a file is written under a temporary name, synced and renamed.

use super::folder;
use super::own::{self, Hashed, TEMPORARY};
use crate::error::{Error, Result};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes `path` through `fill`; the old file stays until the new one is complete and on disk.
///
/// Missing parent folders are made. The temporary file lies in the same folder, starts with a dot and is removed when
/// anything fails.
///
/// # Errors
/// [`Error::Io`] naming `path` and the step that failed; [`Error::Argument`] for a file that this program did not write, see
/// [`own::check`].
pub fn write(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<Hashed>) -> io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    let failed = |action| move |source| Error::io(path, action, source);
    let parent = folder(path);
    if path.file_name().is_none() {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "not a file name");
        return Err(Error::io(path, "create", source));
    }
    own::check(path)?;
    fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create folder", e))?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY[0]).suffix(TEMPORARY[1]);
    // By default only the user could read the file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let (file, temporary) = builder
        .tempfile_in(parent)
        .map_err(failed("create"))?
        .into_parts();
    let hash = Sha256::new();
    let mut out = BufWriter::with_capacity(1 << 20, Hashed { file, hash });
    fill(&mut out)
        .and_then(|()| out.flush())
        .map_err(failed("write"))?;
    let Hashed { file, hash } = out
        .into_inner()
        .map_err(|e| failed("write")(e.into_error()))?;
    file.sync_all().map_err(failed("sync"))?;
    drop(file);
    // Before the file is there: a process that is killed now leaves no file without a record.
    own::note(path, &format!("{:x}", hash.finalize()))?;
    temporary
        .persist(path)
        .map_err(|e| Error::io(path, "rename into place", e.error))?;
    own::stamp(path);
    // The rename is on disk only once the folder is.
    #[cfg(unix)]
    fs::File::open(parent)
        .and_then(|folder| folder.sync_all())
        .map_err(failed("sync"))?;
    Ok(())
}

/// Writes `bytes` to `path` as [`write()`] does.
///
/// # Errors
/// As [`write()`].
pub fn write_bytes(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    write(path, |out| out.write_all(bytes))
}

/// Writes `value` to `path` as indented JSON, as [`write()`] does.
///
/// # Errors
/// As [`write()`].
pub fn write_json(path: impl AsRef<Path>, value: &impl Serialize) -> Result<()> {
    write(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        out.write_all(b"\n")
    })
}

/// Removes the file at `path`, if there is one.
///
/// # Errors
/// [`Error::Io`] naming `path`; [`Error::Argument`] for a file that this program did not write.
pub fn remove(path: impl AsRef<Path>) -> Result<()> {
    own::check(&path)?;
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(Error::io(path, "remove", error))
        }
        _ => Ok(()),
    }
}

/// Whether both names lead to the same existing file, which must not be overwritten while it is read.
pub fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
