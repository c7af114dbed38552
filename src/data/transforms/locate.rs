//! The file of cameras in a scene folder, or what is there instead of it.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Models of COLMAP, relative to the folder that is given.
const COLMAP: [&str; 4] =
    ["sparse/0/cameras.bin", "sparse/0/cameras.txt", "sparse/cameras.bin", "colmap/sparse/0/cameras.bin"];

/// Path of the file `transforms` in the scene folder `dir`, which is there; cheap, so that a run can ask before it begins.
///
/// # Errors
/// [`Error::Missing`] when there is no such folder; [`Error::Input`] when it is no folder, or lacks the file: then the
/// error says which other layout the folder seems to have.
pub fn locate(dir: &Path, transforms: &str) -> Result<PathBuf> {
    if !dir.try_exists().map_err(|e| Error::io(dir, "look at", e))? {
        let mend = "give the scene folder that holds transforms.json and the photos (--data, or data.dir)".into();
        return Err(Error::Missing { what: "folder", path: dir.to_owned(), mend });
    }
    if !dir.is_dir() {
        let mend = "give the folder that holds transforms.json, not a file";
        return Err(Error::input(dir, "scene", "a file", "a scene folder", mend));
    }
    let path = dir.join(transforms);
    if path.is_file() {
        return Ok(path);
    }
    let expected = "cameras and frames as nerfstudio and instant-ngp write them (README, 'Data')";
    if let Some(model) = COLMAP.into_iter().find(|model| dir.join(model).is_file()) {
        let found = format!("no such file, but a COLMAP model ({model})");
        let mend = "COLMAP's layout is not read yet: convert it, for instance with nerfstudio's `ns-process-data` or \
                    instant-ngp's `colmap2nerf.py`, and give undistorted photos";
        return Err(Error::input(dir, transforms, found, expected, mend));
    }
    let (found, mend) = match alternatives(dir) {
        others if others.is_empty() => ("no such file".to_owned(), "give another folder, or write the file".to_owned()),
        others => (
            format!("no such file, but {}", others.join(", ")),
            format!("name one with --set data.transforms={}", others[0]),
        ),
    };
    Err(Error::input(dir, transforms, found, expected, mend))
}

/// Files of `dir` that may be meant, by name.
fn alternatives(dir: &Path) -> Vec<String> {
    let names = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|n| n.starts_with("transforms") && n.ends_with(".json")).collect();
    names.sort_unstable();
    names.truncate(4);
    names
}
