//! Label maps and masks in folders beside the photos.

use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::label_folder::LabelFolder;
use super::mask_file::Masks;
use std::path::Path;

/// Folders of label maps and masks for layouts whose frames name no such files: `labels`, `labels_raw`, `instances`, masks.
pub(crate) struct SideFolders {
    truth: LabelFolder,
    raw: LabelFolder,
    instances: LabelFolder,
    masks: Masks,
}

impl SideFolders {
    pub fn new(folder: Folder<'_>, problems: &mut Problems) -> Self {
        let Folder { dir, options, .. } = folder;
        let raw = options.raw_labels.as_deref();
        Self {
            truth: LabelFolder::new(dir.join("labels")),
            raw: raw.map_or_else(
                || LabelFolder::new(dir.join("labels_raw")),
                |named| LabelFolder::required(dir.join(named)),
            ),
            instances: LabelFolder::new(dir.join("instances")),
            masks: Masks::new(folder, problems),
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
