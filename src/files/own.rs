//! Records which files this program wrote, so that it overwrites no others.
//!
//! The program calls [`guard`]; the library by itself writes wherever it is told to. With the guard, each folder that is written
//! into has a record, [`RECORD`]: a line for each file with the SHA-256 of its content, the command, and its name. A file is own
//! as long as its content is what such a line says.

use super::{folder, lock};
use crate::error::{Error, Result, bail, ensure};
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::collections::{HashMap, HashSet};
use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

/// How the names of temporary files begin and end.
pub(super) const TEMPORARY: [&str; 2] = [".coseg-", ".tmp"];
/// Temporary files that are older belong to processes that were killed.
const ABANDONED: Duration = Duration::from_secs(3600);
/// The record of a folder.
pub const RECORD: &str = ".coseg-files";
/// The first line of a record.
const FIRST: &str =
    "SHA-256 and name of each file that coseg wrote here. It writes over no others.\n";

/// Time and size of a file.
pub type Stamp = (SystemTime, u64);

/// What this process knows of records.
#[derive(Default)]
struct Known {
    /// This command, and others whose files it may write over; empty without a guard.
    commands: Vec<String>,
    /// Lines of the records, by folder.
    lines: HashMap<PathBuf, HashSet<String>>,
    /// Time and size of the files that this process wrote: as long as they stay, nobody else has changed the content.
    stamps: HashMap<PathBuf, Stamp>,
    /// Files and folders that may be written over.
    allowed: HashSet<PathBuf>,
}

static KNOWN: LazyLock<Mutex<Known>> = LazyLock::new(Mutex::default);

thread_local! {
    /// What this thread knows instead, during [`guarded`].
    static OF_THREAD: RefCell<Option<Known>> = const { RefCell::new(None) };
}

fn with_known<T>(work: impl FnOnce(&mut Known) -> T) -> T {
    OF_THREAD.with_borrow_mut(|of_thread| match of_thread {
        Some(known) => work(known),
        None => work(&mut KNOWN.lock().unwrap_or_else(PoisonError::into_inner)),
    })
}

/// From now on this process, which runs the first one of `commands`, writes over no files but those that these commands wrote.
pub fn guard(commands: &[&str]) {
    let commands = commands.iter().copied().map(str::to_owned).collect();
    with_known(|known| known.commands = commands);
}

/// Calls `work` as a process of its own that has this [`guard`]: for programs that run several commands. It holds for what this
/// thread writes.
pub fn guarded<T>(commands: &[&str], work: impl FnOnce() -> T) -> T {
    struct Restored(Option<Known>);
    impl Drop for Restored {
        fn drop(&mut self) {
            OF_THREAD.set(self.0.take());
        }
    }
    let _restored = Restored(OF_THREAD.replace(Some(Known::default())));
    guard(commands);
    work()
}

/// Lets this process write over `path`, or over all files that lie in the folder `path`.
pub fn allow(path: impl AsRef<Path>) {
    with_known(|known| known.allowed.insert(path.as_ref().to_owned()));
}

/// Refuses to write over the file at `path`, unless this program wrote it. Commands call this before they start to work.
///
/// # Errors
/// [`Error::Argument`] naming the file; [`Error::Io`] where it cannot be read.
pub fn check(path: impl AsRef<Path>) -> Result<()> {
    check_argument("output", path)
}

/// As [`check`], where `argument` gave the path.
///
/// # Errors
/// As [`check`].
pub fn check_argument(argument: &str, path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    let Ok(there) = fs::symlink_metadata(path) else {
        return Ok(());
    };
    let stamp = stamp_at(&there);
    let is_known = with_known(|known| {
        let is_allowed = |path: &Path| known.allowed.contains(path);
        known.commands.is_empty()
            || is_allowed(path)
            || is_allowed(folder(path))
            || stamp.is_some() && known.stamps.get(path) == stamp.as_ref()
    });
    if is_known {
        return Ok(());
    }
    ensure!(there.is_file() && is_recorded(path)?,
        argument "{argument}"; found "{}, which this command did not write, or which was changed since", path.display();
        expected "a new file, or one that this command wrote"; help "move it away, or name another output");
    Ok(())
}

/// [`check`] for each file in `folder`, if it is there. Hidden files do not count.
///
/// # Errors
/// As [`check`].
pub fn check_folder(folder: impl AsRef<Path>) -> Result<()> {
    let folder = folder.as_ref();
    let is_file = |name: &str, path: &Path| !name.starts_with('.') && !path.is_dir();
    let mut names = super::names(folder, is_file).into_iter();
    names.try_for_each(|name| check(folder.join(name)))
}

/// Whether the record of its folder has the file as it is.
fn is_recorded(path: &Path) -> Result<bool> {
    let digest = super::sha256(path)?;
    let lines = read(folder(path))?;
    let commands = with_known(|known| known.commands.clone());
    let mut recorded = commands.iter().map(|command| line(path, &digest, command));
    Ok(recorded.any(|line| lines.contains(&line)))
}

/// Removes the temporary files in `folder` that killed processes left there.
fn remove_abandoned(folder: &Path) {
    let is_temporary =
        |name: &str, _: &Path| name.starts_with(TEMPORARY[0]) && name.ends_with(TEMPORARY[1]);
    for name in super::names(folder, is_temporary) {
        let path = folder.join(name);
        let written = fs::symlink_metadata(&path).and_then(|there| there.modified());
        let age = written.ok().and_then(|time| time.elapsed().ok());
        if age.is_some_and(|age| age > ABANDONED) {
            // What stays does no harm.
            let _ = fs::remove_file(path);
        }
    }
}

/// Notes that a file with this SHA-256 is about to take its place at `path`. The first time in a folder, removes what killed
/// processes left there.
pub(super) fn note(path: &Path, digest: &str) -> Result<()> {
    with_known(|known| note_in(known, path, digest))
}

fn note_in(known: &mut Known, path: &Path, digest: &str) -> Result<()> {
    let folder = folder(path);
    let Some(command) = known.commands.first() else {
        return Ok(());
    };
    if !known.lines.contains_key(folder) {
        remove_abandoned(folder);
        let lines = read(folder)?;
        known.lines.insert(folder.to_owned(), lines);
    }
    let record = folder.join(RECORD);
    let line = line(path, digest, command);
    let lines = known.lines.entry(folder.to_owned()).or_default();
    if !lines.insert(line.clone()) && record.is_file() {
        return Ok(());
    }
    let append = |record: &Path| -> io::Result<()> {
        let mut file = OpenOptions::new().create(true).append(true).open(record)?;
        let first = if file.metadata()?.len() == 0 {
            FIRST
        } else {
            ""
        };
        // One call, which other processes do not split.
        file.write_all(format!("{first}{line}\n").as_bytes())
    };
    append(&record).map_err(|e| Error::io(&record, "write", e))
}

/// Notes when the file at `path` was written.
pub(super) fn stamp(path: &Path) {
    // Metadata of a link itself, as in [`check`].
    let written = fs::symlink_metadata(path).ok();
    if let Some(stamp) = written.as_ref().and_then(stamp_at) {
        with_known(|known| known.stamps.insert(path.to_owned(), stamp));
    }
}

/// Time and size of the file at `path`, or that a link there leads to, which change with its content; `None` if there is none.
pub fn stamp_of(path: &Path) -> Option<Stamp> {
    stamp_at(&fs::metadata(path).ok()?)
}

fn stamp_at(there: &Metadata) -> Option<Stamp> {
    Some((there.modified().ok()?, there.len()))
}

/// Removes the record and the lock of a folder that holds nothing else, and the folder.
pub fn remove_empty(folder: impl AsRef<Path>) {
    let folder = folder.as_ref();
    let ours = [RECORD, lock::FILE];
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    if entries
        .map(|entry| entry.file_name())
        .any(|name| !ours.iter().any(|own| name == *own))
    {
        return;
    }
    // What stays does no harm.
    for name in ours {
        let _ = fs::remove_file(folder.join(name));
    }
    with_known(|known| known.lines.remove(folder));
    let _ = fs::remove_dir(folder);
}

/// Removes the files in `folder` that this program wrote, and its folders and itself where nothing else is in them.
///
/// # Errors
/// [`Error::Io`].
pub fn remove_folder(folder: &Path) -> Result<()> {
    for name in super::names(folder, |name, _| !name.starts_with('.')) {
        let path = folder.join(name);
        if path.is_dir() && !path.is_symlink() {
            remove_folder(&path)?;
        } else if check(&path).is_ok() {
            fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
        }
    }
    remove_empty(folder);
    Ok(())
}

/// The lines of the record of `folder`; none if there is no record.
fn read(folder: &Path) -> Result<HashSet<String>> {
    let path = folder.join(RECORD);
    if fs::symlink_metadata(&path).is_err() {
        return Ok(HashSet::new());
    }
    let text = super::text(&path)?;
    let Some(lines) = text.strip_prefix(FIRST) else {
        bail!(&path, "line 1"; found "another text"; expected "the record of the files that coseg wrote";
            help "move it away; coseg then writes over no file of this folder");
    };
    Ok(lines.lines().map(str::to_owned).collect())
}

fn line(path: &Path, digest: &str, command: &str) -> String {
    // Escaped, because a name may have line ends.
    let name = super::file_name(path).unwrap_or_default();
    format!("{digest} {command} {}", name.escape_debug())
}

/// Passes bytes on to a file and hashes them.
#[derive(Debug)]
pub struct Hashed {
    pub(super) file: File,
    pub(super) hash: Sha256,
}

impl Write for Hashed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::atomic::write_bytes;

    #[test]
    fn a_guarded_piece_of_work_writes_over_files_of_its_commands_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        let by = |commands: &[&'static str], text: &str| {
            guarded(commands, || write_bytes(&path, text.as_bytes()))
        };
        write_bytes(&path, b"of nobody").expect("no guard");
        assert!(by(&["edit"], "of edit").is_err());
        fs::remove_file(&path).expect("removed");
        by(&["edit"], "of edit").expect("a new file");
        by(&["edit"], "of edit again").expect("its own file");
        assert!(by(&["train"], "of train").is_err());
        by(&["train", "edit"], "of train").expect("a file of the second command");
        let inner = guarded(&["train"], || {
            assert!(by(&["edit"], "of edit").is_err());
            write_bytes(&path, b"of train again")
        });
        inner.expect("the outer guard again");
        // What was allowed ends with the work as well.
        guarded(&["edit"], || {
            allow(&path);
            write_bytes(&path, b"of edit")
        })
        .expect("allowed");
        write_bytes(&path, b"changed").expect("no guard");
        assert!(by(&["edit"], "of edit").is_err());
    }
}
