//! Label maps and masks of frames in a folder that the user names instead of the one that the frames name.

use super::schema::Frame;
use super::sources::Sources;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};

/// A folder that holds a file of each frame, or of some.
pub(crate) struct Beside {
    folder: PathBuf,
    said: fn(&Frame) -> Option<&String>,
    /// Of what the frames say.
    of_said: Ends,
    of_photos: Ends,
}

impl Beside {
    /// The folder, and what the frames say of the files, where they do.
    pub fn new(folder: PathBuf, sources: &Sources, said: fn(&Frame) -> Option<&String>) -> Self {
        let frames = || {
            sources
                .files
                .iter()
                .flat_map(|source| &source.transforms.frames)
        };
        let of_said = Ends::of(frames().filter_map(said));
        Self {
            folder,
            said,
            of_said,
            of_photos: Ends::of(frames().map(|frame| &frame.file_path)),
        }
    }

    /// Files that may be meant for a frame, the likeliest first: what the frame says, then the path of its photo, each below the
    /// folder and without its first folders as far as that leaves no two frames with one file; then the view's name.
    fn files(&self, frame: &Frame, name: &str) -> Vec<PathBuf> {
        let said = (self.said)(frame)
            .map(|path| self.of_said.alone(path))
            .unwrap_or_default();
        let as_said = said
            .iter()
            .flat_map(|path| [path.clone(), path.with_extension("png"), behind(path)]);
        let of_photo = self.of_photos.alone(&frame.file_path);
        let by_photo = of_photo
            .iter()
            .flat_map(|path| [path.with_extension("png"), behind(path)]);
        let files = as_said
            .chain(by_photo)
            .chain([PathBuf::from(format!("{name}.png"))]);
        files.map(|path| self.folder.join(path)).collect()
    }

    /// The file of a frame, where it is there.
    pub fn file_of(&self, frame: &Frame, name: &str) -> Option<PathBuf> {
        self.files(frame, name)
            .into_iter()
            .find(|path| path.is_file())
    }

    /// The file of a frame, or a folder of masks of that name without extension; where neither is there the file that is missed.
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
            let said = (self.said)(frame).and_then(|path| self.of_said.alone(path).pop());
            self.folder
                .join(said.unwrap_or_else(|| PathBuf::from(format!("{name}.png"))))
        })
    }
}

/// `a.jpg.png` of `a.jpg`.
fn behind(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".png");
    name.into()
}

/// Paths by their ends, extensions aside: `None` for what is the end of several.
struct Ends(HashMap<PathBuf, Option<PathBuf>>);

impl Ends {
    fn of<'a>(paths: impl Iterator<Item = &'a String>) -> Self {
        let mut all: HashMap<PathBuf, Option<PathBuf>> = HashMap::new();
        for path in paths {
            let whole = below(path).with_extension("");
            for end in ends(&whole) {
                let of = all.entry(end).or_insert_with(|| Some(whole.clone()));
                if of.as_ref() != Some(&whole) {
                    *of = None;
                }
            }
        }
        Self(all)
    }

    /// The path, and its ends that no other path has; longest first.
    fn alone(&self, path: &str) -> Vec<PathBuf> {
        let whole = below(path);
        let is_alone = |end: &PathBuf| {
            self.0
                .get(&end.with_extension(""))
                .is_some_and(Option::is_some)
        };
        ends(&whole)
            .enumerate()
            .filter(|(i, end)| *i == 0 || is_alone(end))
            .map(|(_, end)| end)
            .collect()
    }
}

/// A path without what leads out of a folder.
fn below(path: &str) -> PathBuf {
    Path::new(path)
        .components()
        .filter(|part| matches!(part, Component::Normal(_)))
        .collect()
}

/// The path, then without its first folder, and so on to its file name.
fn ends(path: &Path) -> impl Iterator<Item = PathBuf> {
    let parts: Vec<_> = path.components().collect();
    (0..parts.len()).map(move |i| parts[i..].iter().collect())
}
