//! What the targets share: readers take paths, fuzzers give bytes.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// The folder of this process, in memory where the system has such a place.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() {
        TempDir::new_in(memory)
    } else {
        TempDir::new()
    };
    folder.expect("a folder")
});

/// Writes `bytes` to the file `name` of a folder, and has it read. What the reader returns is dropped.
pub fn read<T>(name: &str, bytes: &[u8], reader: impl FnOnce(&Path) -> T) {
    let path = FOLDER.path().join(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    fs::write(&path, bytes).expect("written");
    drop(reader(&path));
}
