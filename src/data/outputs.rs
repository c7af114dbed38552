//! Folders that commands may write into: none that holds a scene's own files.

use super::blocks::Block;
use super::formats::folder::Problems;
use super::formats::layout;
use super::formats::listing::Cloud;
use super::{Classes, LoadOptions};
use crate::error::{Result, ensure};
use crate::files;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Folders above an output folder that are looked at for a scene.
const LEVELS: usize = 3;
/// Names of folders in a scene that are read as true labels, true instances and masks once they are there.
const RESERVED: [&str; 3] = ["labels", "instances", "masks"];

/// Refuses to write into `folders` where that would overwrite photos, poses, label maps or masks: where one of them is a scene
/// folder, or the loader reads it for the scene in `dir` or for a scene above it. `option` named the folders.
///
/// # Errors
/// [`crate::Error::Argument`].
pub fn check_outputs(
    option: &str,
    folders: &[&Path],
    scene: Option<(&Path, &LoadOptions)>,
) -> Result<()> {
    let read = scene.map(|(dir, options)| folders_read(dir, options));
    let read = read.unwrap_or_default();
    for folder in folders {
        let place = absolute(folder);
        ensure!(!read.contains(&place) && !is_read_by_scene_above(&place),
            argument "{option}"; found "{}, which holds files of a scene", folder.display();
            expected "a folder of its own: photos, poses, label maps and classes are never overwritten";
            help "name a new folder");
    }
    Ok(())
}

/// Refuses to write `file` where it is an input of the scene in folder `dir`: a photo, a label map, a mask, the cloud or the class
/// table.
///
/// # Errors
/// [`crate::Error::Argument`].
pub fn check_output_file(
    option: &str,
    file: &Path,
    (dir, options): (&Path, &LoadOptions),
) -> Result<()> {
    let place = absolute(file);
    let mut read = files_read(dir, options).into_iter();
    ensure!(read.all(|file| absolute(&file) != place),
        argument "{option}"; found "{}, a file of the scene", file.display();
        expected "another file"; help "name a new file");
    Ok(())
}

/// Whether a scene that lies in `folder` or above reads files in it, or would if the folder existed.
fn is_read_by_scene_above(folder: &Path) -> bool {
    let options = LoadOptions::default();
    let mut scenes = folder.ancestors().take(LEVELS + 1);
    scenes.any(|dir| {
        let is_read = || folders_read(dir, &options).contains(folder);
        let is_reserved = || RESERVED.iter().any(|name| dir.join(name) == folder);
        layout::locate(dir, &options).is_ok() && (is_reserved() || is_read())
    })
}

/// The folders whose files make the scene in folder `dir`, and that folder.
fn folders_read(dir: &Path, options: &LoadOptions) -> BTreeSet<PathBuf> {
    let files = files_read(dir, options);
    let paths = || files.iter().map(PathBuf::as_path);
    // Raw labels may be folders themselves.
    let folders = paths().filter(|file| file.is_dir());
    let parents = paths().map(files::folder);
    folders.chain(parents).map(absolute).collect()
}

/// Photos, label maps, masks, the initial cloud and the class table of the scene in folder `dir`, whether or not they are there.
fn files_read(dir: &Path, options: &LoadOptions) -> Vec<PathBuf> {
    // Faults of the scene, and of a block of one, are reported where it is loaded.
    let block = Block::in_folder(dir).ok().flatten();
    let whole = block.and_then(|block| block.scene_folder(dir).ok());
    let mut files = vec![dir.join(Classes::FILE)];
    files.extend(whole.map(|whole| whole.join(Classes::FILE)));
    if let Ok(listing) = layout::list(dir, options, &mut Problems::default()) {
        for frame in &listing.frames {
            files.push(frame.image.clone());
            files.extend(frame.maps().cloned());
        }
        if let Cloud::Ply(cloud) = listing.cloud {
            files.push(cloud);
        }
    }
    files
}

/// The path with links resolved as far as it exists.
fn absolute(path: &Path) -> PathBuf {
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let resolved = full.ancestors().find_map(|above| {
        let rest = full.strip_prefix(above).ok()?;
        Some(above.canonicalize().ok()?.join(rest))
    });
    resolved.unwrap_or(full)
}
