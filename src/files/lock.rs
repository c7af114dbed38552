//! The lock of a folder that one process at a time writes.

use super::own;
use crate::error::{Error, Result, bail, ensure};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;

/// The file that is locked. It holds the number of the process that locked it last.
pub const FILE: &str = ".coseg-lock";

/// A locked folder, until this is dropped or the process ends.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

/// Calls `work` while `folder` is locked. Where it fails, a lock file and a folder that this made are removed, the folder if nothing
/// else is in it.
///
/// # Errors
/// As [`Lock::new`]; those of `work`.
pub fn locked<T>(folder: &Path, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let is_there = |path: &Path| fs::symlink_metadata(path).is_ok();
    let had_folder = is_there(folder);
    let had_file = is_there(&folder.join(FILE));
    let _lock = Lock::new(folder)?;
    work().inspect_err(|_| {
        if !had_folder {
            own::remove_empty(folder);
        }
        if !had_file {
            // What stays does no harm.
            let _ = fs::remove_file(folder.join(FILE));
        }
    })
}

impl Lock {
    /// Locks `folder`, which is made if absent.
    ///
    /// # Errors
    /// [`Error::Input`] naming the process that has it; [`Error::Io`].
    pub fn new(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let path = folder.join(FILE);
        let failed = |action| move |e| Error::io(folder.join(FILE), action, e);
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create folder", e))?;
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).map_err(failed("open"))?;
        let mut holder = String::new();
        // Where the system locks the content too, nobody can read it.
        let _ = (&file).take(20).read_to_string(&mut holder);
        let is_process = holder.trim().parse::<u32>().is_ok();
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = holder.trim();
                let holder = if is_process {
                    format!("process {holder}")
                } else {
                    "another process".to_owned()
                };
                bail!(folder, "lock"; found "{holder}, which writes this folder"; expected "one process at a time";
                    help "wait until it ends, or name another folder");
            }
            // Some network drives have no locks.
            Err(TryLockError::Error(error)) => {
                tracing::warn!("{}: not locked: {error}", path.display());
                return Ok(Self { _file: file });
            }
        }
        ensure!(holder.is_empty() || is_process, &path, "content"; found "another text"; expected "the number of a process";
            help "move it away");
        file.set_len(0).map_err(failed("write"))?;
        file.rewind().map_err(failed("write"))?;
        let holder = format!("{}\n", std::process::id());
        file.write_all(holder.as_bytes()).map_err(failed("write"))?;
        Ok(Self { _file: file })
    }
}
