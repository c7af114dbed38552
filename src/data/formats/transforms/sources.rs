//! The file that lists the frames, or one file for each split, as in the Blender scenes of NeRF.

use super::schema::Transforms;
use super::splits::{self, Splits};
use crate::config::DataConfig;
use crate::data::formats::folder::Problems;
use crate::data::formats::frame::joined_name;
use crate::data::{LoadOptions, Split};
use crate::error::{Result, invalid};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The files of Blender's scenes.
const TRAIN: &str = "transforms_train.json";
const TEST: &str = "transforms_test.json";
const VALIDATION: &str = "transforms_val.json";

/// The files that list the frames of a folder.
pub(super) struct Sources {
    /// The file, or the names of several, for messages.
    pub file: PathBuf,
    /// At least one.
    pub files: Vec<Source>,
    /// What is left out.
    pub notices: Vec<String>,
}

/// One of the files.
pub(super) struct Source {
    pub transforms: Transforms,
    splits: Splits,
}

/// A frame that is read.
pub(super) struct Kept {
    /// Number of its file.
    pub source: usize,
    /// Number in the file.
    pub index: usize,
    pub split: Split,
    pub name: String,
}

/// The files of `dir` that list its frames: the file that the options name, else the usual one, else Blender's. Each of these has
/// one split; validation frames stand in for test frames.
fn files(dir: &Path, options: &LoadOptions) -> Option<Vec<(String, Option<Split>)>> {
    let is_there = |name: &str| dir.join(name).is_file();
    if is_there(&options.transforms) {
        return Some(vec![(options.transforms.clone(), None)]);
    }
    let held_out = [TEST, VALIDATION].into_iter().find(|name| is_there(name))?;
    let is_usual = options.transforms == DataConfig::default().transforms;
    let files = [(TRAIN, Split::Train), (held_out, Split::Test)];
    (is_usual && is_there(TRAIN)).then(|| {
        files
            .map(|(name, split)| (name.to_owned(), Some(split)))
            .into()
    })
}

/// The first of the files that list the frames of `dir`, if there are any.
pub(crate) fn marker(dir: &Path, options: &LoadOptions) -> Option<String> {
    let (first, _) = files(dir, options)?.into_iter().next()?;
    Some(first)
}

impl Sources {
    /// Reads the files of `dir`.
    pub fn read(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Self> {
        let files = files(dir, options).unwrap_or_else(|| vec![(options.transforms.clone(), None)]);
        let names: Vec<&str> = files.iter().map(|(name, _)| &**name).collect();
        let paths = files.iter().map(|(name, split)| (dir.join(name), *split));
        let mut sources = Self::of(dir.join(names.join(" and ")), paths, problems)?;
        if files.len() > 1 && names.contains(&TEST) && dir.join(VALIDATION).is_file() {
            let notice = format!("{VALIDATION} is not read: the frames of {TEST} are held out");
            sources.notices.push(notice);
        }
        Ok(sources)
    }

    /// Reads one file and ignores others in the same folder.
    pub fn of_file(path: &Path, problems: &mut Problems) -> Result<Self> {
        Self::of(path.to_owned(), [(path.to_owned(), None)], problems)
    }

    /// Reads files. All frames of one that comes with a split belong to it. `file` stands for all in messages.
    fn of(
        file: PathBuf,
        paths: impl IntoIterator<Item = (PathBuf, Option<Split>)>,
        problems: &mut Problems,
    ) -> Result<Self> {
        let mut files = Vec::new();
        let mut notices = Vec::new();
        for (path, split) in paths {
            let transforms = Transforms::read(&path)?;
            let splits = match split {
                Some(_) => splits::all(transforms.frames.len(), split),
                None => transforms.splits(&mut notices, problems),
            };
            files.push(Source { transforms, splits });
        }
        Ok(Self {
            file,
            files,
            notices,
        })
    }

    /// The frames that the options keep, in the order of the files. Frames whose names are faults are left out.
    pub fn pick(&self, options: &LoadOptions, problems: &mut Problems) -> Vec<Kept> {
        let frames: Vec<_> = self.frames().collect();
        let splits: Vec<Option<Split>> = frames.iter().map(|(.., split)| *split).collect();
        let mut names = self.names(problems);
        let picked = options.pick(&splits).into_iter();
        let kept = picked.filter_map(|(place, split)| {
            let (source, index, _) = frames[place];
            Some(Kept {
                source,
                index,
                split,
                name: names[place].take()?,
            })
        });
        kept.collect()
    }

    /// The name of each frame: the stem of its photo. Where photos of several files have the same stems, it is the path with
    /// folders joined by `_`. A name that is empty or that an earlier frame has is a fault, and is `None`.
    fn names(&self, problems: &mut Problems) -> Vec<Option<String>> {
        let stem = |file: &str| Some(Path::new(file).file_stem()?.to_str()?.to_owned());
        let joined =
            |file: &str| Some(joined_name(Path::new(file))).filter(|name| !name.is_empty());
        let photo = |source: usize, i: usize| &*self.files[source].transforms.frames[i].file_path;
        let mut stems = HashMap::new();
        let by_path = self.files.len() > 1
            && self.frames().any(|(source, i, _)| {
                *stems.entry(stem(photo(source, i))).or_insert(source) != source
            });
        let mut first: HashMap<String, (usize, usize)> = HashMap::new();
        let mut names = Vec::new();
        for (source, i, _) in self.frames() {
            let transforms = &self.files[source].transforms;
            let path = &transforms.path;
            let photo = photo(source, i);
            let field = format!("{}.file_path", transforms.field(i));
            let name = if by_path { joined(photo) } else { stem(photo) };
            let earlier = name.as_ref().and_then(|name| first.get(name));
            match (&name, earlier) {
                (None, _) => problems.push(invalid!(path, "{field}"; found "{photo:?}";
                    expected "the path of an image"; help "name the image file")),
                (Some(name), None) => _ = first.insert(name.clone(), (source, i)),
                (Some(name), Some(&(other, earlier))) => {
                    let other_file = &self.files[other].transforms;
                    let mut earlier = other_file.field(earlier);
                    if other != source {
                        let file = other_file.path.file_name().unwrap_or_default();
                        earlier += &format!(" of {}", file.display());
                    }
                    let what = if by_path { "path" } else { "stem" };
                    let mut help = "rename one of the images or drop the repeated frame".to_owned();
                    if self.files.len() > 1 {
                        help +=
                            &format!(", or read one file alone with --set data.transforms={TRAIN}");
                    }
                    problems.push(invalid!(path, "{field}"; found "{what} {name:?}, which {earlier} has too";
                        expected "file stems that differ: views and outputs are named by them"; help "{help}"));
                }
            }
            names.push(name.filter(|name| first.get(name) == Some(&(source, i))));
        }
        names
    }

    /// The frames that are read: number of the file, number of the frame in the file, and its split where the file gives one.
    fn frames(&self) -> impl Iterator<Item = (usize, usize, Option<Split>)> {
        let files = self.files.iter().enumerate();
        files.flat_map(|(source, file)| {
            file.splits
                .iter()
                .map(move |&(i, split)| (source, i, split))
        })
    }
}
