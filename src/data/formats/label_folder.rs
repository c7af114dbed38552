//! Label maps and masks that are found by the names of their photos.

use super::frame::{Frame, joined_name};
use crate::config::RawFormat;
use crate::data::labels::raw::{LABELS_RAW, ShapeFile, labelme};
use crate::data::{LoadOptions, first_names};
use crate::files::{self, extension};
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// Where the file of a photo may lie in a folder: its path with `.png` instead of its extension or after it, the name of its
/// view, or its stem.
pub(crate) fn names(folder: &Path, photo: &Path) -> [PathBuf; 4] {
    let png = |name: &str| folder.join(format!("{name}.png"));
    [
        folder.join(photo).with_extension("png"),
        png(&photo.to_string_lossy()),
        png(&joined_name(photo)),
        png(&photo.file_stem().unwrap_or_default().to_string_lossy()),
    ]
}

/// The first of `names` that is a file.
pub(crate) fn file(names: &[PathBuf]) -> Option<PathBuf> {
    names.iter().find(|path| path.is_file()).cloned()
}

/// The first of `names` that is a file, or else the first that is a folder of masks, with its name without extension.
pub(crate) fn map(names: &[PathBuf]) -> Option<PathBuf> {
    let mut folders = names.iter().map(|path| path.with_extension(""));
    file(names).or_else(|| folders.find(|folder| folder.is_dir()))
}

/// The first of `names` that is a JSON file.
pub(crate) fn drawn(names: &[PathBuf]) -> Option<PathBuf> {
    let mut files = names.iter().map(|path| path.with_extension("json"));
    files.find(|path| path.is_file())
}

/// Decides which files hold the raw labels of `frames`: label maps, shapes of LabelMe, or a file of COCO or CVAT for all. Photos
/// without a file in the folder that the options name are unlabelled, unless none has one.
pub(super) fn choose_raw_files(dir: &Path, options: &LoadOptions, frames: &mut [Frame]) {
    let labelme_fits = matches!(options.raw_format, RawFormat::Auto | RawFormat::Labelme);
    let is_json = |path: &PathBuf| path.extension().is_some_and(|e| e == "json");
    for frame in frames.iter_mut().filter(|_| options.raw_labels.is_none()) {
        // A frame may name the file.
        frame.drawn = frame.raw.clone().filter(is_json).or(frame.drawn.take());
    }
    let exists = |frame: &Frame| frame.raw.as_ref().is_some_and(|path| path.exists());
    let has_maps = frames.iter().any(exists);
    let first_drawn = frames.iter().find_map(|frame| frame.drawn.as_ref());
    // JSON files are LabelMe's where there are no other labels, or where the first one has shapes.
    let is_labelme = |first: &PathBuf| !has_maps || labelme::has_shapes(first);
    if labelme_fits && first_drawn.is_some_and(is_labelme) {
        for frame in frames.iter_mut() {
            let map = std::mem::replace(&mut frame.raw, frame.drawn.clone());
            frame.has_unread_map = map.is_some_and(|map| {
                map.exists() && frame.raw.as_ref() != Some(&map) && !is_copy(&map, &frame.image)
            });
        }
        return;
    }
    frames.iter_mut().for_each(|frame| frame.drawn = None);
    let is_used = |file: &ShapeFile| {
        let labelled = frames.iter().filter(|frame| exists(frame));
        let maps = labelled.filter_map(|frame| frame.raw.as_deref());
        let named = dir.join(options.raw_labels.as_deref().unwrap_or_default());
        options.raw_format != RawFormat::Auto || !has_maps || file.replaces(&named, maps)
    };
    if let Some(file) = ShapeFile::find(dir, options).filter(is_used) {
        // Which photos it labels is known once it was read.
        frames
            .iter_mut()
            .for_each(|frame| frame.raw = Some(file.path.clone()));
    } else if has_maps && options.raw_labels.is_some() {
        let without = frames.iter_mut().filter(|frame| !exists(frame));
        without.for_each(|frame| frame.raw = None);
    }
}

/// Whether a file in the folder of raw labels is the photo itself, or a copy of it, by its size.
fn is_copy(map: &Path, photo: &Path) -> bool {
    let bytes = |path: &Path| path.metadata().ok().map(|there| there.len());
    bytes(map) == bytes(photo)
}

/// A notice on files of LabelMe that lie beside those of `frames`, or in the folder of raw labels, and belong to no photo. Where only
/// some photos are read, there is none.
pub(super) fn stray_drawings(
    dir: &Path,
    options: &LoadOptions,
    frames: &[Frame],
) -> Option<String> {
    let labelme_fits = matches!(options.raw_format, RawFormat::Auto | RawFormat::Labelme);
    if !labelme_fits || options.stride > 1 || options.max_frames > 0 {
        return None;
    }
    let drawn = || frames.iter().filter_map(|frame| frame.drawn.as_deref());
    let raw = || frames.iter().filter_map(|frame| frame.raw.as_deref());
    let used: HashSet<&Path> = drawn().chain(raw()).collect();
    let parents = drawn().map(|file| files::folder(file).to_owned());
    let usual = || raw().next().is_none().then_some(LABELS_RAW);
    let folder = options.raw_labels.as_deref().or_else(usual);
    let folders: BTreeSet<PathBuf> = parents.chain(folder.map(|name| dir.join(name))).collect();
    let is_stray = |_: &str, path: &Path| {
        extension(path) == "json" && !used.contains(path) && labelme::has_shapes(path)
    };
    let strays = folders
        .iter()
        .flat_map(|folder| files::names(folder, is_stray));
    let strays: Vec<String> = strays.collect();
    (!strays.is_empty()).then(|| {
        format!(
            "{} files of LabelMe belong to no photo of the scene: {}; a file has the name of its photo",
            strays.len(),
            first_names(&strays)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_comes_before_the_folder_of_other_photos() {
        let dir = tempfile::tempdir().expect("a folder");
        let names = names(dir.path(), Path::new("left.jpg"));
        // Of photos left/NAME.jpg, or masks of left.jpg.
        let folder = dir.path().join("left");
        std::fs::create_dir(&folder).expect("a folder");
        assert_eq!(map(&names), Some(folder));
        let file = dir.path().join("left.jpg.png");
        std::fs::write(&file, "").expect("a file");
        assert_eq!(map(&names), Some(file));
    }
}
