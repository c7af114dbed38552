//! Label files that are not read, because of their names or because nothing looks where they lie.

use super::frame::{Frame, joined_name};
use crate::config::RawFormat;
use crate::data::labels::raw::{LABELS_RAW, OTHER_FILES, ShapeFile, labelme};
use crate::data::photos::is_photo;
use crate::data::{LoadOptions, first_names};
use crate::error::{Error, invalid};
use crate::files::{extension, file_name, names};
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// Whether only some photos of the folder are read: others may have the labels.
const fn reads_some(options: &LoadOptions) -> bool {
    options.stride > 1 || options.max_frames > 0
}

/// Why none of `frames` has raw labels, where the usual folder for them is there and nothing names another one.
pub(super) fn no_label_file(dir: &Path, options: &LoadOptions, frames: &[Frame]) -> Option<Error> {
    let folder = dir.join(LABELS_RAW);
    let first = frames.first()?;
    let is_labelled = frames.iter().any(|frame| frame.raw.is_some());
    if options.raw_labels.is_some() || is_labelled || reads_some(options) || !folder.is_dir() {
        return None;
    }
    let is_label = |name: &str, _: &Path| !name.starts_with('.') && !OTHER_FILES.contains(&name);
    let files = names(&folder, is_label);
    let found = match files.len() {
        0 => "no file".to_owned(),
        1 => format!("{}, which is no PNG named like a photo", files[0]),
        n => format!(
            "{n} files, none of which is a PNG named like a photo: {}",
            first_names(&files)
        ),
    };
    let photo = file_name(&first.image).unwrap_or_default();
    let map = file_name(&first.image.with_extension("png")).unwrap_or_default();
    Some(
        invalid!(folder, "raw labels"; found "{found}"; expected "a label map for some photo, as {map} for {photo}";
            help "{}", how_to_read(dir, options, frames, &files)),
    )
}

/// What to do where none of `files` in the usual folder is the label map of one of `frames`.
fn how_to_read(dir: &Path, options: &LoadOptions, frames: &[Frame], files: &[String]) -> String {
    let named = LoadOptions {
        raw_labels: Some(LABELS_RAW.to_owned()),
        ..options.clone()
    };
    let drawn = ShapeFile::find(dir, &named).filter(|file| !labelme::has_shapes(&file.path));
    if let Some(file) = drawn
        .as_ref()
        .and_then(|file| file.path.strip_prefix(dir).ok())
    {
        return format!("--set data.raw_labels={} reads that file", file.display());
    }
    let stems: HashSet<_> = frames.iter().map(|frame| frame.image.file_stem()).collect();
    let mut paths = files.iter().map(Path::new);
    if paths
        .any(|path| is_photo(path) && extension(path) != "png" && stems.contains(&path.file_stem()))
    {
        return "save the ids as PNG: JPEG compression changes them".to_owned();
    }
    "name each map like its photo, or remove the folder".to_owned()
}

/// A notice on PNG files in the folder of raw labels that belong to no photo, where others do.
pub(super) fn stray_maps(dir: &Path, options: &LoadOptions, frames: &[Frame]) -> Option<String> {
    let folder = dir.join(options.raw_labels.as_deref().unwrap_or(LABELS_RAW));
    let is_map = |path: &&Path| path.starts_with(&folder) && extension(path) == "png";
    let raw = frames.iter().filter_map(|frame| frame.raw.as_deref());
    let used: HashSet<&Path> = raw.filter(is_map).collect();
    if used.is_empty() || reads_some(options) {
        return None;
    }
    let photos = photo_names(&folder, frames);
    let is_stray = |_: &str, path: &Path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        extension(path) == "png" && !used.contains(path) && !photos.contains(&*stem)
    };
    let strays = names(&folder, is_stray);
    (!strays.is_empty()).then(|| {
        format!(
            "{} label maps in {} belong to no photo and are not read: {}",
            strays.len(),
            folder.display(),
            first_names(&strays)
        )
    })
}

/// What label maps of photos may be called, without `.png`. Photos of the scene that are no frames count too: those without a pose, or
/// left out by a split. `maps` is the folder of label maps.
fn photo_names(maps: &Path, frames: &[Frame]) -> HashSet<String> {
    let parents: BTreeSet<&Path> = frames
        .iter()
        .filter_map(|frame| frame.image.parent())
        .collect();
    let mut folders: BTreeSet<PathBuf> =
        parents.iter().map(|folder| folder.to_path_buf()).collect();
    // Each split may have a folder of its own.
    if parents.len() > 1 {
        for above in parents.iter().filter_map(|folder| folder.parent()) {
            let beside = names(above, |_, path| path.is_dir() && path != maps);
            folders.extend(beside.iter().map(|name| above.join(name)));
        }
    }
    let mut all: HashSet<String> = frames.iter().map(|frame| frame.name.clone()).collect();
    for folder in folders {
        let own = folder.file_name().unwrap_or_default();
        for photo in names(&folder, |_, path| is_photo(path)) {
            all.insert(joined_name(Path::new(&photo)));
            all.insert(joined_name(&Path::new(own).join(&photo)));
            all.insert(photo);
        }
    }
    all
}

/// A notice on files of LabelMe beside the photos of `frames`, where they are not read as `data.raw_labels` names no folder.
pub(super) fn drawings_beside_photos(
    dir: &Path,
    options: &LoadOptions,
    frames: &[Frame],
) -> Option<String> {
    let labelme_fits = matches!(options.raw_format, RawFormat::Auto | RawFormat::Labelme);
    if !labelme_fits || options.raw_labels.is_some() {
        return None;
    }
    let beside = |frame: &Frame| {
        let file = frame.image.with_extension("json");
        (file.is_file() && frame.raw.as_ref() != Some(&file)).then_some(file)
    };
    let mut drawn: Vec<PathBuf> = frames.iter().filter_map(beside).collect();
    // Other programs write a file of another kind for each photo.
    if !labelme::has_shapes(drawn.first()?) {
        return None;
    }
    drawn.retain(|file| labelme::has_shapes(file));
    let folder = common_folder(frames.iter().filter_map(|frame| frame.image.parent()))?;
    let name = match folder.strip_prefix(dir) {
        Ok(inner) if inner.as_os_str().is_empty() => Path::new("."),
        Ok(inner) => inner,
        Err(_) => &folder,
    };
    let (count, name) = (drawn.len(), name.display());
    Some(format!(
        "{count} files of LabelMe in {name} are not read: --set data.raw_labels={name} reads them"
    ))
}

/// The innermost folder that holds all of `folders`.
fn common_folder<'a>(mut folders: impl Iterator<Item = &'a Path>) -> Option<PathBuf> {
    let first = folders.next()?.to_owned();
    Some(folders.fold(first, |common, folder| {
        let mut parts = common.components().zip(folder.components());
        parts
            .by_ref()
            .take_while(|(a, b)| a == b)
            .map(|(a, _)| a)
            .collect()
    }))
}
