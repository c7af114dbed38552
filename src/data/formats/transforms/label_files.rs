//! Where the label maps and masks of frames lie: where the frames say, or in a folder that the user names instead.

use super::schema;
use super::sources::Sources;
use crate::data::formats::folder::{Folder, Problems};
use crate::data::formats::frame::{Frame, below};
use crate::data::formats::label_folder::{drawn, file, map};
use crate::data::formats::mask_file::Masks;
use crate::data::labels::raw::LABELS_RAW;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Finds the files of frames.
pub(super) struct LabelFiles<'a> {
    dir: &'a Path,
    masks: Masks,
    /// The folder of raw labels that the user names, or the usual one where no frame names a raw label.
    raw: Option<PathBuf>,
    /// Whether the user names that folder. Then some photo must have a file in it.
    is_raw_named: bool,
    of_photos: Endings,
    of_masks: Endings,
    of_raw: Endings,
}

impl<'a> LabelFiles<'a> {
    pub fn new(folder: Folder<'a>, sources: &Sources, problems: &mut Problems) -> Self {
        let Folder { dir, options, .. } = folder;
        let all = sources.files.iter();
        let frames = || all.clone().flat_map(|source| &source.transforms.frames);
        let names_raw = frames().any(|frame| frame.raw_label_path.is_some());
        let usual_raw = (!names_raw).then_some(LABELS_RAW);
        Self {
            dir,
            masks: Masks::new(folder, problems),
            raw: options
                .raw_labels
                .as_deref()
                .or(usual_raw)
                .map(|raw| dir.join(raw)),
            is_raw_named: options.raw_labels.is_some(),
            of_photos: Endings::new(frames().map(|frame| &frame.file_path)),
            of_masks: Endings::new(frames().filter_map(|frame| frame.mask_path.as_ref())),
            of_raw: Endings::new(frames().filter_map(|frame| frame.raw_label_path.as_ref())),
        }
    }

    /// `frame` with the files of `fields`, which are its entry in the file.
    pub fn add(&self, frame: Frame, fields: &schema::Frame) -> Frame {
        let in_scene = |path: &Option<String>| path.as_ref().map(|path| self.dir.join(path));
        let in_folder = |folder: &Path, of_frame: &[PathBuf]| {
            let photos = self.of_photos.unique(Some(&fields.file_path));
            let files = candidates(of_frame, &photos, &frame.name).into_iter();
            files.map(|path| folder.join(path)).collect::<Vec<_>>()
        };
        let mask = match &self.masks {
            Masks::Off => None,
            Masks::OfFrames => in_scene(&fields.mask_path),
            Masks::In(folder) => {
                let of_frame = self.of_masks.unique(fields.mask_path.as_ref());
                file(&in_folder(folder, &of_frame))
            }
        };
        let (raw, drawn) = match &self.raw {
            None => (in_scene(&fields.raw_label_path), None),
            Some(folder) => {
                let mut of_frame = self.of_raw.unique(fields.raw_label_path.as_ref());
                let files = in_folder(folder, &of_frame);
                let usual = of_frame.pop();
                let usual = usual.unwrap_or_else(|| with_png(Path::new(&frame.name)));
                let expected = self.is_raw_named.then(|| folder.join(usual));
                (map(&files).or(expected), drawn(&files))
            }
        };
        Frame {
            mask,
            truth: in_scene(&fields.label_path),
            drawn,
            raw,
            instances: in_scene(&fields.instance_path),
            ..frame
        }
    }
}

/// Possible files of a frame in a folder, the likeliest first: those of the paths `of_frame` that the frame names, then those of
/// its photo, and the view's name last. Leading folders of these paths are cut off only as long as no two frames share a file, see
/// [`Endings::unique`].
fn candidates(of_frame: &[PathBuf], photos: &[PathBuf], name: &str) -> Vec<PathBuf> {
    let png = |path: &PathBuf| [path.with_extension("png"), with_png(path)];
    let of_frame = of_frame
        .iter()
        .flat_map(|path| [&[path.clone()][..], &png(path)].concat());
    let photos = photos.iter().flat_map(png);
    of_frame
        .chain(photos)
        .chain([with_png(Path::new(name))])
        .collect()
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
            let whole = below(Path::new(path)).with_extension("");
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
    fn unique(&self, path: Option<&String>) -> Vec<PathBuf> {
        let whole = path.map(|path| below(Path::new(path))).unwrap_or_default();
        let is_unique = |ending: &PathBuf| {
            let known = self.0.get(&ending.with_extension(""));
            *ending == whole || known.is_some_and(Option::is_some)
        };
        endings(&whole).filter(is_unique).collect()
    }
}

/// The path, then without its first folder, and so on to its file name.
fn endings(path: &Path) -> impl Iterator<Item = PathBuf> {
    let parts: Vec<_> = path.components().collect();
    (0..parts.len()).map(move |i| parts[i..].iter().collect())
}
