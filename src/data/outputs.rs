//! Folders that commands may write into: none that holds a scene's own files.

use super::LoadOptions;
use super::blocks::Block;
use super::formats::folder::Problems;
use super::formats::frame::Frame;
use super::formats::layout;
use super::formats::listing::Cloud;
use crate::error::{Result, bail, ensure};
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
    let read = scene
        .map(|(dir, options)| folders_read(dir, options))
        .unwrap_or_default();
    for folder in folders {
        let place = absolute(folder);
        if is_scene(&place) || read.contains(&place) || is_read_by_scene_above(&place) {
            let found = format!("{}, which holds files of a scene", folder.display());
            let expected =
                "a folder of its own: photos, poses, label maps and classes are never overwritten";
            bail!(argument "{option}"; found "{found}"; expected "{expected}";
                help "name a new folder");
        }
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
    let own = files_read(dir, options)
        .into_iter()
        .chain([whole(dir).join("classes.json")]);
    ensure!(own.map(|file| absolute(&file)).all(|file| file != place),
        argument "{option}"; found "{}, a file of the scene", file.display();
        expected "another file"; help "name a new file");
    Ok(())
}

fn is_scene(folder: &Path) -> bool {
    layout::locate(folder, &LoadOptions::default()).is_ok()
}

fn is_read_by_scene_above(folder: &Path) -> bool {
    let is_reserved = folder
        .file_name()
        .is_some_and(|name| RESERVED.iter().any(|reserved| name == *reserved));
    let mut above = folder.ancestors().skip(1).take(LEVELS).enumerate();
    above.any(|(level, dir)| {
        is_scene(dir)
            && (level == 0 && is_reserved
                || folders_read(dir, &LoadOptions::default()).contains(folder))
    })
}

/// The folders whose files make the scene in folder `dir`.
fn folders_read(dir: &Path, options: &LoadOptions) -> BTreeSet<PathBuf> {
    let files = files_read(dir, options);
    // Raw labels may be folders themselves.
    let folders = files
        .iter()
        .filter(|file| file.is_dir())
        .map(PathBuf::as_path);
    let parents = files.iter().filter_map(|file| file.parent());
    let whole = whole(dir);
    let scenes = [dir, &whole];
    folders.chain(parents).chain(scenes).map(absolute).collect()
}

/// The folder of the whole scene, where `dir` is a block of one; else `dir`. Faults of a block are reported where it is loaded.
fn whole(dir: &Path) -> PathBuf {
    let block = Block::in_folder(dir).ok().flatten();
    let scene = block.and_then(|block| block.scene_folder(dir).ok());
    scene.unwrap_or_else(|| dir.to_owned())
}

/// Photos, label maps, masks and the initial cloud of the scene in folder `dir`.
fn files_read(dir: &Path, options: &LoadOptions) -> Vec<PathBuf> {
    // Faults of the scene are reported where it is loaded.
    let listing = layout::list(dir, options, &mut Problems::default());
    let cloud = listing.iter().filter_map(|listing| match &listing.cloud {
        Cloud::Ply(file) => Some(file.clone()),
        _ => None,
    });
    let files = |frame: &Frame| {
        let maps = [&frame.mask, &frame.truth, &frame.raw, &frame.instances];
        let maps = maps.into_iter().flatten().cloned();
        [frame.image.clone()]
            .into_iter()
            .chain(maps)
            .collect::<Vec<_>>()
    };
    let frames = listing.iter().flat_map(|listing| &listing.frames);
    frames.flat_map(files).chain(cloud).collect()
}

/// The path with links resolved as far as it exists.
fn absolute(path: &Path) -> PathBuf {
    let mut rest = Vec::new();
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    for above in full.ancestors() {
        if let Ok(place) = above.canonicalize() {
            return rest
                .into_iter()
                .rev()
                .fold(place, |place: PathBuf, name| place.join(name));
        }
        rest.extend(above.file_name());
    }
    full
}
