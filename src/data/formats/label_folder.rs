//! Label maps and masks in folders beside the photos, found by the names of the photos.

use super::frame::{Frame, joined_name};
use super::listing::Problems;
use crate::config::Layout;
use crate::data::LoadOptions;
use crate::data::labels::mask_file::Masks;
use std::path::{Path, PathBuf};

/// Folders of label maps and masks for layouts whose frames name no such files: `labels`, `labels_raw`, `instances`, masks.
pub(crate) struct SideFolders {
    truth: LabelFolder,
    raw: LabelFolder,
    instances: LabelFolder,
    masks: Masks,
}

impl SideFolders {
    pub fn new(dir: &Path, options: &LoadOptions, layout: Layout, problems: &mut Problems) -> Self {
        let raw = options.raw_labels.as_deref();
        Self {
            truth: LabelFolder::new(dir.join("labels")),
            raw: LabelFolder {
                folder: dir.join(raw.unwrap_or("labels_raw")),
                // Some photo must have a map in a folder that the user names.
                required: raw.is_some(),
            },
            instances: LabelFolder::new(dir.join("instances")),
            masks: Masks::new(dir, options, layout, problems),
        }
    }

    /// The frame with the files of the photo that lies at `photo` below the folder of photos.
    pub fn frame(&self, frame: Frame, photo: &Path) -> Frame {
        Frame {
            mask: self.masks.of_photo(photo),
            truth: self.truth.map(photo),
            raw: self.raw.map(photo),
            drawn: self.raw.drawn(photo),
            instances: self.instances.map(photo),
            ..frame
        }
    }
}

/// A folder with files named after photos.
pub(crate) struct LabelFolder {
    folder: PathBuf,
    required: bool,
}

impl LabelFolder {
    /// A folder in which some photos may lack a file.
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            required: false,
        }
    }

    /// The map of a photo: a file as in [`LabelFolder::file`], or a folder of masks of such a name without `.png`.
    fn map(&self, photo: &Path) -> Option<PathBuf> {
        let names = self.names(photo);
        let masks = || {
            names
                .iter()
                .map(|path| path.with_extension(""))
                .find(|path| path.is_dir())
        };
        let usual = || Some(names[0].clone()).filter(|_| self.required);
        self.file(photo).or_else(masks).or_else(usual)
    }

    /// The JSON file of a photo, named as [`LabelFolder::file`].
    fn drawn(&self, photo: &Path) -> Option<PathBuf> {
        let names = self.names(photo).into_iter();
        names
            .map(|path| path.with_extension("json"))
            .find(|path| path.is_file())
    }

    /// The file of a photo: its path with `.png` for its extension or behind it, the name of its view, or its stem.
    pub fn file(&self, photo: &Path) -> Option<PathBuf> {
        self.names(photo).into_iter().find(|path| path.is_file())
    }

    fn names(&self, photo: &Path) -> [PathBuf; 4] {
        let png = |name: &str| self.folder.join(format!("{name}.png"));
        [
            self.folder.join(photo).with_extension("png"),
            png(&photo.to_string_lossy()),
            png(&joined_name(photo)),
            png(&photo.file_stem().unwrap_or_default().to_string_lossy()),
        ]
    }
}
