//! Where a COLMAP model lies in a scene folder, and what of the photos it leaves out.

use super::{PosedImage, binary, text};
use crate::data::Limits;
use crate::error::{Error, Result};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Folders of models, relative to the scene folder, the first that are there count; the last is nerfstudio's. With `N` the
/// mapper writes one for each piece of the scene that it could not join to the others.
const FOLDERS: [&str; 3] = ["sparse/N", "sparse", "colmap/sparse/N"];
/// Names in a notice before it counts the others.
const NAMED: usize = 3;

/// The files of a model.
pub(super) struct Model {
    pub folder: PathBuf,
    pub cameras: ModelFile,
    pub images: ModelFile,
    /// What is said of other models beside it.
    pub passed_over: Option<String>,
}

impl Model {
    /// The model with the most photos.
    ///
    /// # Errors
    /// There is no model, or only a part of it.
    pub fn find(dir: &Path) -> Result<Self> {
        let candidates = candidates(dir);
        let pieces = candidates.iter().map(|folder| (photos(&dir.join(folder)), folder));
        let Some((most, chosen)) = pieces.clone().reduce(|a, b| if b.0 > a.0 { b } else { a }) else {
            let expected = "a model in sparse/0 or sparse: cameras, images and points3D as .bin or .txt";
            let mend = "run `colmap mapper`, or give another folder";
            return Err(Error::input(dir, "sparse/0", "no model", expected, mend));
        };
        let others: Vec<String> = pieces
            .filter(|(_, folder)| *folder != chosen)
            .map(|(count, folder)| format!("{folder} of {count}"))
            .collect();
        let passed_over = (!others.is_empty()).then(|| {
            format!(
                "{chosen}, a model of {most} photos, is read, and not {}: COLMAP could not join these pieces; to read \
                 another, take {chosen} out of the folder",
                others.join(", ")
            )
        });
        let folder = dir.join(chosen);
        let (cameras, images) = (part(&folder, "cameras")?, part(&folder, "images")?);
        Ok(Self { folder, cameras, images, passed_over })
    }
}

/// The file by which a model in a scene folder is known, relative to it, if there is one.
pub(in crate::data) fn found(dir: &Path) -> Option<String> {
    let folder = candidates(dir).into_iter().next()?;
    let file = any(&dir.join(&folder))?;
    Some(format!("{folder}/{}", file.path().file_name()?.to_string_lossy()))
}

/// Folders with a model or a part of one, of the first kind in [`FOLDERS`] that has any, by their numbers.
fn candidates(dir: &Path) -> Vec<String> {
    let folders = FOLDERS.iter().map(|kind| match kind.strip_suffix("/N") {
        Some(parent) => numbers(&dir.join(parent)).into_iter().map(|n| format!("{parent}/{n}")).collect(),
        None => vec![(*kind).to_owned()],
    });
    let with_models = folders.map(|mut folders: Vec<String>| {
        folders.retain(|folder| any(&dir.join(folder)).is_some());
        folders
    });
    with_models.into_iter().find(|folders| !folders.is_empty()).unwrap_or_default()
}

/// Numbers that are folders in `dir`, in order.
fn numbers(dir: &Path) -> Vec<u32> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten().filter(|entry| entry.path().is_dir());
    let number = |name: String| name.parse::<u32>().ok().filter(|n| n.to_string() == name);
    let mut numbers: Vec<u32> = entries.filter_map(|e| number(e.file_name().into_string().ok()?)).collect();
    numbers.sort_unstable();
    numbers
}

/// Its cameras, or else its images.
fn any(folder: &Path) -> Option<ModelFile> {
    ModelFile::find(folder, "cameras").or_else(|| ModelFile::find(folder, "images"))
}

/// How many photos the model in `folder` has; none where it cannot be read, which is an error only where it is the one that is
/// taken.
fn photos(folder: &Path) -> u64 {
    match ModelFile::find(folder, "images") {
        Some(ModelFile::Binary(path)) => binary::image_count(&path).unwrap_or(0),
        Some(ModelFile::Text(path)) => text::images(&path).map_or(0, |images| images.len() as u64),
        None => 0,
    }
}

/// A file of a model in either form.
#[derive(Clone, Debug)]
pub(super) enum ModelFile {
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
}

fn part(folder: &Path, name: &str) -> Result<ModelFile> {
    ModelFile::find(folder, name).ok_or_else(|| {
        let expected = format!("{name}.bin or {name}.txt");
        Error::input(folder, name, "no such file", expected, "copy the whole model: cameras, images and points3D")
    })
}

/// What is said of photos that `images`, the whole model, does not have: COLMAP leaves out what it cannot place.
pub(super) fn unplaced(photos: &Path, images: &[PosedImage]) -> Option<String> {
    let placed: HashSet<&Path> = images.iter().map(|image| Path::new(&image.name)).collect();
    let mut all = Vec::new();
    list_photos(photos, Path::new(""), &mut all);
    let count = all.len();
    all.retain(|path| !placed.contains(path.as_path()));
    all.sort_unstable();
    let names: Vec<_> = all.iter().take(NAMED).map(|path| path.display().to_string()).collect();
    let more = if all.len() > NAMED { ", ..." } else { "" };
    // A model of other photos altogether is an error elsewhere, by the names that it has.
    (!all.is_empty() && all.len() < count).then(|| {
        let of = format!("{} of the {count} photos in {}", all.len(), photos.display());
        format!(
            "{of} are not in the model and so are not used ({}{more}): COLMAP could not place them",
            names.join(", ")
        )
    })
}

/// Photos in `folder/below` and in its folders, by their paths within `folder`.
fn list_photos(folder: &Path, below: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder.join(below)).into_iter().flatten().flatten() {
        let path = below.join(entry.file_name());
        // Links to folders are not followed: they may lead back.
        match entry.file_type() {
            Ok(kind) if kind.is_dir() => list_photos(folder, &path, out),
            Ok(_) if is_photo(&path) => out.push(path),
            _ => {}
        }
    }
}

fn is_photo(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["png", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}
