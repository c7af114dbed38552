//! The file that lists the frames, or the files, one for each split, as Blender's scenes of NeRF have them.

use super::schema::Transforms;
use super::splits::Splits;
use crate::config::DataConfig;
use crate::data::formats::frame::joined_name;
use crate::data::formats::listing::Problems;
use crate::data::{LoadOptions, Split};
use crate::error::{Error, Result};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The files of Blender's scenes.
const TRAIN: &str = "transforms_train.json";
const TEST: &str = "transforms_test.json";
const VALIDATION: &str = "transforms_val.json";

/// What lists the frames of a folder, as its files say by themselves.
pub(crate) struct Sources {
    /// For messages: the file, or several in one text.
    pub file: PathBuf,
    /// At least one.
    pub files: Vec<Source>,
    /// What was left out.
    pub notices: Vec<String>,
}

/// One of the files.
pub(crate) struct Source {
    pub path: PathBuf,
    pub transforms: Transforms,
    splits: Splits,
}

impl Source {
    /// Reads a file, whose frames are all of `split` where there is one.
    fn read(path: PathBuf, split: Option<Split>, problems: &mut Problems) -> Result<Self> {
        let transforms = Transforms::read(&path)?;
        let splits = match split {
            Some(_) => Splits::all(transforms.frames.len(), split),
            None => transforms.splits(&path, problems),
        };
        Ok(Self {
            path,
            transforms,
            splits,
        })
    }
}

/// A frame that is read.
pub(crate) struct Kept {
    /// Number of its file.
    pub source: usize,
    /// Number in the file.
    pub index: usize,
    pub split: Split,
    /// `None` of a frame that was told of.
    pub name: Option<String>,
}

/// The files of `dir` that list its frames, each with the split of all of its frames where there are several: the file that the
/// options name, or Blender's, where that is the usual one and not there. Validation frames stand in for test frames.
fn files(dir: &Path, options: &LoadOptions) -> Option<Vec<(String, Option<Split>)>> {
    let there = |name: &str| dir.join(name).is_file();
    if there(&options.transforms) {
        return Some(vec![(options.transforms.clone(), None)]);
    }
    let held_out = [TEST, VALIDATION].into_iter().find(|name| there(name))?;
    let usual = options.transforms == DataConfig::default().transforms && there(TRAIN);
    usual.then(|| {
        vec![
            (TRAIN.to_owned(), Some(Split::Train)),
            (held_out.to_owned(), Some(Split::Test)),
        ]
    })
}

/// The first of the files that list the frames of `dir`, if there are any.
pub(crate) fn found(dir: &Path, options: &LoadOptions) -> Option<String> {
    files(dir, options)?
        .into_iter()
        .next()
        .map(|(name, _)| name)
}

impl Sources {
    /// Reads the files of `dir`, where some were [`found`].
    pub fn read(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Self> {
        let files = files(dir, options).unwrap_or_else(|| vec![(options.transforms.clone(), None)]);
        let names: Vec<&str> = files.iter().map(|(name, _)| &**name).collect();
        let file = dir.join(names.join(" and "));
        let mut notices = Vec::new();
        if names.contains(&TEST) && files.len() > 1 && dir.join(VALIDATION).is_file() {
            notices.push(format!(
                "{VALIDATION} is not read: the frames of {TEST} are what is held out"
            ));
        }
        let mut read = Vec::with_capacity(files.len());
        for (name, split) in &files {
            let mut source = Source::read(dir.join(name), *split, problems)?;
            notices.append(&mut source.splits.notices);
            read.push(source);
        }
        Ok(Self {
            file,
            files: read,
            notices,
        })
    }

    /// One file, whatever lies beside it.
    pub fn of_file(path: &Path, problems: &mut Problems) -> Result<Self> {
        let source = Source::read(path.to_owned(), None, problems)?;
        Ok(Self {
            file: path.to_owned(),
            files: vec![source],
            notices: Vec::new(),
        })
    }

    /// The frames that the options keep, in the order of the files. A name that an earlier frame has is a fault.
    pub fn pick(&self, options: &LoadOptions, problems: &mut Problems) -> Vec<Kept> {
        let frames: Vec<_> = self.frames().collect();
        let given: Vec<Option<Split>> = frames.iter().map(|(.., split)| *split).collect();
        let names = self.names(problems);
        let kept = options.pick(&given).into_iter().map(|(place, split)| {
            let (source, index, _) = frames[place];
            Kept {
                source,
                index,
                split,
                name: names[source][index].clone(),
            }
        });
        kept.collect()
    }

    /// The name of each frame of each file: the stem of its photo, or, where photos of several files have the same stems, their
    /// paths, folders joined by `_`. `None` where it is empty or an earlier frame has it, which is a fault, and for frames that
    /// are left out.
    fn names(&self, problems: &mut Problems) -> Vec<Vec<Option<String>>> {
        let stem = |file: &str| {
            Path::new(file)
                .file_stem()
                .and_then(|stem| stem.to_str())
                .map(str::to_owned)
        };
        let joined =
            |file: &str| Some(joined_name(Path::new(file))).filter(|name| !name.is_empty());
        let by_path = self.files.len() > 1 && {
            let mut sources = HashMap::new();
            self.frames().any(|(source, i, _)| {
                let stem = stem(&self.files[source].transforms.frames[i].file_path);
                *sources.entry(stem).or_insert(source) != source
            })
        };
        let mut names: Vec<Vec<_>> = self
            .files
            .iter()
            .map(|file| vec![None; file.transforms.frames.len()])
            .collect();
        let mut first: HashMap<String, (usize, usize)> = HashMap::new();
        for (source, i, _) in self.frames() {
            let Source {
                path, transforms, ..
            } = &self.files[source];
            let photo = &transforms.frames[i].file_path;
            let field = format!("{}.file_path", transforms.field(i));
            let Some(name) = (if by_path { joined(photo) } else { stem(photo) }) else {
                let expected = "the path of an image";
                problems.push(Error::input(
                    path,
                    field,
                    format!("{photo:?}"),
                    expected,
                    "name the image file",
                ));
                continue;
            };
            if let Some(&(of, earlier)) = first.get(&name) {
                let Source {
                    path: other,
                    transforms,
                    ..
                } = &self.files[of];
                let other = other
                    .file_name()
                    .filter(|_| of != source)
                    .unwrap_or_default();
                let of_file = if other.is_empty() {
                    String::new()
                } else {
                    format!(" of {}", other.display())
                };
                let earlier = transforms.field(earlier);
                let what = if by_path { "path" } else { "stem" };
                let alone = if self.files.len() > 1 {
                    format!(", or read one file alone with --set data.transforms={TRAIN}")
                } else {
                    String::new()
                };
                problems.push(Error::input(
                    path,
                    field,
                    format!("{what} {name:?}, which {earlier}{of_file} has too"),
                    "file stems that differ: views and outputs are named by them",
                    format!("rename one of the images or drop the repeated frame{alone}"),
                ));
                continue;
            }
            first.insert(name.clone(), (source, i));
            names[source][i] = Some(name);
        }
        names
    }

    /// Number of the file, of the frame in it, and the split that is said of it, of those that are not left out.
    fn frames(&self) -> impl Iterator<Item = (usize, usize, Option<Split>)> {
        let files = self.files.iter().enumerate();
        files.flat_map(|(source, file)| {
            file.splits
                .frames
                .iter()
                .map(move |&(i, split)| (source, i, split))
        })
    }
}
