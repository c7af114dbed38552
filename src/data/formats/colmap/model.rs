//! Where a COLMAP model lies in a scene folder, and what of the photos it leaves out.

use super::{PosedImage, binary, text};
use crate::data::Limits;
use crate::data::diagnostics::cautions::some_of;
use crate::error::{Error, Result};
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

/// Folders of models, relative to the scene folder: of the first kind that is there; the last is nerfstudio's. With `N`
/// the mapper writes one for each piece of the scene that it could not join to the others.
const FOLDERS: [&str; 3] = ["sparse/N", "sparse", "colmap/sparse/N"];
/// Files in a folder of photos that are looked at.
const MOST_FILES: usize = 100_000;

/// The files of a model.
pub(crate) struct SparseModel {
    pub folder: PathBuf,
    pub cameras: ModelFile,
    pub images: ModelFile,
    /// What is said of other models beside it.
    pub passed_over: Option<String>,
}

impl SparseModel {
    /// The model with the most photos.
    ///
    /// # Errors
    /// There is no model, or only a part of it; of several, one cannot be read.
    pub fn find(dir: &Path, limits: &Limits) -> Result<Self> {
        let folders = candidates(dir);
        let mut found = Self::one(dir, &folders)?;
        if folders.len() < 2 {
            return Ok(found);
        }
        let mut counts = Vec::new();
        for folder in &folders {
            counts.push(part(&dir.join(folder), "images")?.image_count(limits)?);
        }
        let most = counts.iter().copied().max().unwrap_or_default();
        let chosen = counts
            .iter()
            .position(|&count| count == most)
            .unwrap_or_default();
        let others = folders
            .iter()
            .zip(&counts)
            .enumerate()
            .filter(|&(i, _)| i != chosen);
        let others: Vec<String> = others
            .map(|(_, (folder, count))| format!("{folder} of {count}"))
            .collect();
        found = Self::one(dir, &folders[chosen..])?;
        let chosen = &folders[chosen];
        found.passed_over = Some(format!(
            "{chosen}, a model of {most} photos, is read, and not {}: COLMAP could not join these pieces; to read another, \
             take {chosen} out of the folder",
            others.join(", ")
        ));
        Ok(found)
    }

    /// Refuses a folder without a whole model.
    pub fn expect(dir: &Path) -> Result<()> {
        Self::one(dir, &candidates(dir)).map(|_| ())
    }

    /// That of the first of `folders`.
    fn one(dir: &Path, folders: &[String]) -> Result<Self> {
        let Some(folder) = folders.first() else {
            let expected =
                "a model in sparse/0 or sparse: cameras, images and points3D as .bin or .txt";
            let help = "run `colmap mapper`, or give another folder";
            return Err(Error::input(dir, "sparse/0", "no model", expected, help));
        };
        let folder = dir.join(folder);
        let (cameras, images) = (part(&folder, "cameras")?, part(&folder, "images")?);
        Ok(Self {
            folder,
            cameras,
            images,
            passed_over: None,
        })
    }
}

/// The file by which a model in a scene folder is known, relative to it, if there is one.
pub(crate) fn found(dir: &Path) -> Option<String> {
    let folder = candidates(dir).into_iter().next()?;
    let file = files(&dir.join(&folder)).into_iter().flatten().next()?;
    Some(format!(
        "{folder}/{}",
        file.path().file_name()?.to_string_lossy()
    ))
}

/// Folders with a model, of the first kind in [`FOLDERS`] that has any, by their numbers. Those with a part of one only where
/// none has a whole one.
fn candidates(dir: &Path) -> Vec<String> {
    for kind in FOLDERS {
        let mut folders: Vec<String> = match kind.strip_suffix("/N") {
            Some(parent) => numbers(&dir.join(parent))
                .into_iter()
                .map(|n| format!("{parent}/{n}"))
                .collect(),
            None => vec![kind.to_owned()],
        };
        let has = |folder: &String| files(&dir.join(folder)).into_iter().flatten().count();
        let most = folders.iter().map(has).max().unwrap_or_default();
        folders.retain(|folder| has(folder) == most);
        if most > 0 {
            return folders;
        }
    }
    Vec::new()
}

/// Its cameras and its images, without which there is no model.
fn files(folder: &Path) -> [Option<ModelFile>; 2] {
    ["cameras", "images"].map(|name| ModelFile::find(folder, name))
}

/// Numbers that are folders in `dir`, in order.
fn numbers(dir: &Path) -> Vec<u32> {
    let entries = std::fs::read_dir(dir)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.path().is_dir());
    let number = |name: String| name.parse::<u32>().ok().filter(|n| n.to_string() == name);
    let mut numbers: Vec<u32> = entries
        .filter_map(|e| number(e.file_name().into_string().ok()?))
        .collect();
    numbers.sort_unstable();
    numbers
}

/// A file of a model in either form.
#[derive(Clone, Debug)]
pub(crate) enum ModelFile {
    Binary(PathBuf),
    Text(PathBuf),
}

impl ModelFile {
    /// `folder/name.bin`, or else `folder/name.txt`.
    pub fn find(folder: &Path, name: &str) -> Option<Self> {
        let [binary, text] = ["bin", "txt"].map(|e| folder.join(format!("{name}.{e}")));
        match (binary.is_file(), text.is_file()) {
            (true, _) => Some(Self::Binary(binary)),
            (false, true) => Some(Self::Text(text)),
            _ => None,
        }
    }

    pub fn path(&self) -> &Path {
        match self {
            Self::Binary(path) | Self::Text(path) => path,
        }
    }

    /// What it says, where it is `images`.
    pub fn images(&self, limits: &Limits) -> Result<Vec<PosedImage>> {
        match self {
            Self::Binary(path) => binary::images(path, limits),
            Self::Text(path) => text::images(path),
        }
    }

    /// How many there are in it, where it is `images`.
    fn image_count(&self, limits: &Limits) -> Result<u64> {
        match self {
            Self::Binary(path) => binary::image_count(path),
            Self::Text(_) => Ok(self.images(limits)?.len() as u64),
        }
    }
}

fn part(folder: &Path, name: &str) -> Result<ModelFile> {
    ModelFile::find(folder, name).ok_or_else(|| {
        let expected = format!("{name}.bin or {name}.txt");
        Error::input(
            folder,
            name,
            "no such file",
            expected,
            "copy the whole model: cameras, images and points3D",
        )
    })
}

/// What is said of photos in the folder `photos` that `images`, the whole model, does not have: COLMAP leaves out what it cannot
/// place.
pub(crate) fn unplaced(photos: &Path, images: &[PosedImage]) -> Option<String> {
    let placed: HashSet<String> = images
        .iter()
        .map(|image| same(Path::new(&image.name)))
        .collect();
    let mut all = Vec::new();
    list_photos(photos, Path::new(""), &mut all);
    let count = all.len();
    let mut others: Vec<String> = all
        .iter()
        .filter(|path| !placed.contains(&same(path)))
        .map(|path| path.display().to_string())
        .collect();
    others.sort_unstable();
    // A model of other photos altogether is an error elsewhere, by the names that it has.
    (!others.is_empty() && others.len() < count).then(|| {
        let of = format!("{} of the {count} photos in {}", others.len(), photos.display());
        let names = some_of(&others);
        format!("{of} are not in the model that is read, and not used: COLMAP did not place them, or they are newer ({names})")
    })
}

/// A path to compare by: some file systems do not tell cases apart.
fn same(path: &Path) -> String {
    let parts = path
        .components()
        .filter(|part| matches!(part, Component::Normal(_)));
    parts
        .map(|part| part.as_os_str().to_string_lossy().to_lowercase())
        .collect::<Vec<_>>()
        .join("/")
}

/// Photos in `folder/below` and in its folders, by their paths within `folder`.
fn list_photos(folder: &Path, below: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder.join(below))
        .into_iter()
        .flatten()
        .flatten()
        .take(MOST_FILES)
    {
        let name = entry.file_name();
        // What systems put beside photos: previews, halves of files.
        if out.len() >= MOST_FILES || name.to_string_lossy().starts_with(['.', '@']) {
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

fn is_photo(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default();
    ["png", "jpg", "jpeg"]
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}
