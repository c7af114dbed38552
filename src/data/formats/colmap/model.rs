//! Where a COLMAP model lies in a scene folder, and which photos it lacks.

use super::images::{self, PosedImage};
use crate::data::first_names;
use crate::data::formats::frame::below;
use crate::data::photos::is_photo;
use crate::error::{Error, Result, invalid};
use crate::files::names;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Parents of numbered models, relative to the scene folder: the mapper writes one for each piece of the scene that it
/// could not join to the others. The last is nerfstudio's. A model may also lie in `sparse` itself.
const MODEL_FOLDERS: [&str; 3] = ["sparse/N", "sparse", "colmap/sparse/N"];
/// Largest number of files in a folder of photos that are listed.
const MAX_FILES: usize = 100_000;

/// The files of a model.
pub(super) struct SparseModel {
    pub folder: PathBuf,
    pub cameras: PathBuf,
    pub images: PathBuf,
    /// A notice on other models beside it.
    pub others: Option<String>,
}

impl SparseModel {
    /// The model with the most photos.
    ///
    /// # Errors
    /// The folder has no model, or only some files of one, or one of several models that cannot be read.
    pub fn find(dir: &Path) -> Result<Self> {
        let folders = candidates(dir);
        let first = Self::first_of(dir, &folders)?;
        if folders.len() < 2 {
            return Ok(first);
        }
        let mut counts = Vec::new();
        for folder in &folders {
            counts.push(images::count(&part(&dir.join(folder), "images")?)?);
        }
        let most = counts.iter().copied().max().unwrap_or_default();
        let is_most = |count: &u64| *count == most;
        let chosen = counts.iter().position(is_most).unwrap_or_default();
        let mut others: Vec<String> = folders
            .iter()
            .zip(&counts)
            .map(|(folder, count)| format!("{folder} of {count}"))
            .collect();
        others.remove(chosen);
        let name = &folders[chosen];
        let notice = format!(
            "{name}, a model of {most} photos, is read, and not {}: COLMAP could not join these pieces; to read another, \
             move {name} out of the folder",
            others.join(", ")
        );
        let model = Self::first_of(dir, &folders[chosen..])?;
        Ok(Self {
            others: Some(notice),
            ..model
        })
    }

    /// Refuses a folder without a whole model.
    pub fn expect(dir: &Path) -> Result<()> {
        Self::first_of(dir, &candidates(dir)).map(|_| ())
    }

    fn first_of(dir: &Path, folders: &[String]) -> Result<Self> {
        let folder = folders.first().ok_or_else(|| {
            invalid!(dir, "sparse/0"; found "no model";
                expected "a model in sparse/0 or sparse: cameras, images and points3D as .bin or .txt";
                help "run `colmap mapper`, or give another folder")
        })?;
        let folder = dir.join(folder);
        Ok(Self {
            cameras: part(&folder, "cameras")?,
            images: part(&folder, "images")?,
            folder,
            others: None,
        })
    }
}

/// The file by which a model in a scene folder is recognised, relative to it, if there is one.
pub(crate) fn marker(dir: &Path) -> Option<String> {
    let folder = candidates(dir).into_iter().next()?;
    let file = parts(&dir.join(&folder)).into_iter().next()?;
    Some(format!("{folder}/{}", file.file_name()?.to_string_lossy()))
}

/// Folders with a model, at the first of [`MODEL_FOLDERS`] that has any, by their numbers. Folders with only a part of a model
/// count where none has a whole one.
fn candidates(dir: &Path) -> Vec<String> {
    for place in MODEL_FOLDERS {
        let mut folders: Vec<String> = match place.strip_suffix("/N") {
            Some(parent) => numbers(&dir.join(parent))
                .iter()
                .map(|n| format!("{parent}/{n}"))
                .collect(),
            None => vec![place.to_owned()],
        };
        let count = |folder: &String| parts(&dir.join(folder)).len();
        let most = folders.iter().map(count).max().unwrap_or_default();
        folders.retain(|folder| count(folder) == most);
        if most > 0 {
            return folders;
        }
    }
    Vec::new()
}

/// Its cameras and its images, without which there is no model.
fn parts(folder: &Path) -> Vec<PathBuf> {
    ["cameras", "images"]
        .into_iter()
        .filter_map(|name| find(folder, name))
        .collect()
}

/// Numbers that are folders in `dir`, in order.
fn numbers(dir: &Path) -> Vec<u32> {
    let number = |name: &str| name.parse::<u32>().ok().filter(|n| n.to_string() == name);
    let folders = names(dir, |name, path| number(name).is_some() && path.is_dir());
    let mut numbers: Vec<u32> = folders.iter().filter_map(|name| number(name)).collect();
    numbers.sort_unstable();
    numbers
}

/// `folder/name.bin`, or else `folder/name.txt`.
pub(super) fn find(folder: &Path, name: &str) -> Option<PathBuf> {
    let forms = ["bin", "txt"].map(|form| folder.join(format!("{name}.{form}")));
    forms.into_iter().find(|path| path.is_file())
}

fn part(folder: &Path, name: &str) -> Result<PathBuf, Error> {
    find(folder, name).ok_or_else(|| {
        invalid!(folder, "{name}"; found "no such file"; expected "{name}.bin or {name}.txt";
            help "copy the whole model: cameras, images and points3D")
    })
}

/// A notice on photos in the folder `photos` that the model lacks: COLMAP leaves out photos that it cannot place.
pub(super) fn unplaced(photos: &Path, images: &[PosedImage]) -> Option<String> {
    let placed: HashSet<String> = images
        .iter()
        .map(|image| comparable(Path::new(&image.name)))
        .collect();
    let mut all = Vec::new();
    list_photos(photos, Path::new(""), &mut all);
    let missing = all
        .iter()
        .filter(|path| !placed.contains(&comparable(path)));
    let mut missing: Vec<String> = missing.map(|path| path.display().to_string()).collect();
    missing.sort_unstable();
    // A model of entirely different photos is an error elsewhere, which gives its names.
    (!missing.is_empty() && missing.len() < all.len()).then(|| {
        format!(
            "{} of the {} photos in {} are not in the model and not used: COLMAP did not place them, or they are newer ({})",
            missing.len(),
            all.len(),
            photos.display(),
            first_names(&missing)
        )
    })
}

/// A path to compare by: some file systems ignore case.
fn comparable(path: &Path) -> String {
    below(path).to_string_lossy().to_lowercase()
}

/// Photos in `folder/below` and in its folders, by their paths within `folder`.
fn list_photos(folder: &Path, below: &Path, out: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder.join(below))
        .into_iter()
        .flatten()
        .flatten();
    for entry in entries.take(MAX_FILES) {
        let name = entry.file_name();
        // Systems put previews and halves of files beside photos.
        if out.len() >= MAX_FILES || name.to_string_lossy().starts_with(['.', '@']) {
            continue;
        }
        let path = below.join(name);
        // Links to folders are not followed: they may lead back.
        match entry.file_type() {
            Ok(kind) if kind.is_dir() => list_photos(folder, &path, out),
            Ok(_) if is_photo(&path) => out.push(path),
            _ => {}
        }
    }
}
