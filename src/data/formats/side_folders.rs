//! Label maps and masks in folders beside the photos.

use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::label_folder::{drawn, map, names};
use super::mask_file::Masks;
use crate::data::labels::raw::LABELS_RAW;
use std::path::Path;

/// Folders of label maps and masks for layouts whose frames name no such files: `labels`, `labels_raw`, `instances`, masks.
pub(crate) struct SideFolders<'a> {
    folder: Folder<'a>,
    masks: Masks,
}

impl<'a> SideFolders<'a> {
    pub fn new(folder: Folder<'a>, problems: &mut Problems) -> Self {
        let masks = Masks::new(folder, problems);
        Self { folder, masks }
    }

    /// The frame with the files of the photo that lies at `photo` below the folder of photos. In a folder of raw labels that the user
    /// names, some photo must have a file.
    pub fn frame(&self, frame: Frame, photo: &Path) -> Frame {
        let Folder { dir, options, .. } = self.folder;
        let files = |folder: &str| names(&dir.join(folder), photo);
        let raw = files(options.raw_labels.as_deref().unwrap_or(LABELS_RAW));
        let usual = || options.raw_labels.is_some().then(|| raw[0].clone());
        Frame {
            mask: self.masks.of_photo(photo),
            truth: map(&files("labels")),
            drawn: drawn(&raw),
            raw: map(&raw).or_else(usual),
            instances: map(&files("instances")),
            ..frame
        }
    }
}
