//! Label maps and masks of frames in a folder that the user names. It replaces the folder that the frames name.

use super::schema::Frame;
use super::sources::Sources;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

/// A folder with a file for each frame, or for some of them.
pub(super) struct NamedFolder {
    folder: PathBuf,
    /// The path that a frame gives for its file.
    given: fn(&Frame) -> Option<&String>,
    of_given: Endings,
    of_photos: Endings,
}

impl NamedFolder {
    pub fn new(folder: PathBuf, sources: &Sources, given: fn(&Frame) -> Option<&String>) -> Self {
        let frames = || {
            sources
                .files
                .iter()
                .flat_map(|source| &source.transforms.frames)
        };
        Self {
            folder,
            given,
            of_given: Endings::new(frames().filter_map(given)),
            of_photos: Endings::new(frames().map(|frame| &frame.file_path)),
        }
    }

    /// Possible files of a frame, the likeliest first. The path that the frame gives comes first, then the path of its photo. Both
    /// are tried below the folder, whole and without leading folders, as long as no two frames share a file. The view's name comes
    /// last.
    fn files(&self, frame: &Frame, name: &str) -> Vec<PathBuf> {
        let mut files = Vec::new();
        for path in self.given_endings(frame) {
            files.extend([path.clone(), path.with_extension("png"), with_png(&path)]);
        }
        for path in self.of_photos.unique(&frame.file_path) {
            files.extend([path.with_extension("png"), with_png(&path)]);
        }
        files.push(with_png(Path::new(name)));
        files.iter().map(|path| self.folder.join(path)).collect()
    }

    fn given_endings(&self, frame: &Frame) -> Vec<PathBuf> {
        (self.given)(frame).map_or(Vec::new(), |path| self.of_given.unique(path))
    }

    /// The file of a frame, if it exists.
    pub fn file(&self, frame: &Frame, name: &str) -> Option<PathBuf> {
        self.files(frame, name)
            .into_iter()
            .find(|path| path.is_file())
    }

    /// The JSON file of a frame, if it exists.
    pub fn drawn(&self, frame: &Frame, name: &str) -> Option<PathBuf> {
        let files = self.files(frame, name).into_iter();
        files
            .map(|path| path.with_extension("json"))
            .find(|path| path.is_file())
    }

    /// The file of a frame, or a folder of masks with that name without extension. Without both, the path of the missing file.
    pub fn file_or_masks(&self, frame: &Frame, name: &str) -> PathBuf {
        let found = self.files(frame, name).into_iter().find_map(|file| {
            let masks = file.with_extension("");
            if file.is_file() {
                Some(file)
            } else {
                Some(masks).filter(|masks| masks.is_dir())
            }
        });
        found.unwrap_or_else(|| {
            let given = self.given_endings(frame).pop();
            self.folder
                .join(given.unwrap_or_else(|| with_png(Path::new(name))))
        })
    }
}

/// `a.jpg.png` for `a.jpg`.
fn with_png(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".png");
    name.into()
}

/// The endings of paths, without extensions, each with its path. An ending of several paths has `None`.
struct Endings(HashMap<PathBuf, Option<PathBuf>>);

impl Endings {
    fn new<'a>(paths: impl Iterator<Item = &'a String>) -> Self {
        let mut all: HashMap<PathBuf, Option<PathBuf>> = HashMap::new();
        for path in paths {
            let whole = below(path).with_extension("");
            for ending in endings(&whole) {
                let of = all.entry(ending).or_insert_with(|| Some(whole.clone()));
                if of.as_ref() != Some(&whole) {
                    *of = None;
                }
            }
        }
        Self(all)
    }

    /// The path, and its endings that no other path has; longest first.
    fn unique(&self, path: &str) -> Vec<PathBuf> {
        let whole = below(path);
        let is_unique = |ending: &PathBuf| {
            let known = self.0.get(&ending.with_extension(""));
            *ending == whole || known.is_some_and(Option::is_some)
        };
        endings(&whole).filter(is_unique).collect()
    }
}

/// A path without components that lead out of a folder.
fn below(path: &str) -> PathBuf {
    let parts = Path::new(path).components();
    parts
        .filter(|part| matches!(part, Component::Normal(_)))
        .collect()
}

/// The path, then without its first folder, and so on to its file name.
fn endings(path: &Path) -> impl Iterator<Item = PathBuf> {
    let parts: Vec<_> = path.components().collect();
    (0..parts.len()).map(move |i| parts[i..].iter().collect())
}
