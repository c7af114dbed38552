//! The photos of the views of a scene folder.

use super::LoadOptions;
use super::formats::folder::Problems;
use super::formats::frame::Frame;
use super::formats::layout;
use super::photos::image_file::{ImageFile, proportional};
use crate::error::Result;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The photo of a view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewPhoto {
    /// Its file.
    pub file: PathBuf,
    /// Its path below the folder that holds all photos of the scene, with `/`.
    pub name: String,
    /// Width and height of its camera, pixels.
    size: (usize, usize),
    is_pinhole: bool,
}

impl ViewPhoto {
    /// Whether a label map of the view, of this width and height in pixels, fits the photo: it has no lens distortion, and the same
    /// proportions.
    pub fn fits(&self, size: (usize, usize)) -> bool {
        self.is_pinhole && proportional(self.size, size)
    }

    /// The file without its EXIF orientation: label maps are of the pixels as they are stored, and some programs turn photos by it.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] where the file is not a complete PNG or JPEG; [`crate::Error::Limit`].
    pub fn without_orientation(&self) -> Result<Vec<u8>> {
        ImageFile::open(&self.file)?.without_orientation(false)
    }
}

/// The photos of the scene in folder `dir` that are there, by the names of their views. Empty where `dir` is not a scene folder:
/// faults are reported where a scene is loaded.
pub fn view_photos(dir: &Path, options: &LoadOptions) -> BTreeMap<String, ViewPhoto> {
    let Ok(listing) = layout::list(dir, options, &mut Problems::default()) else {
        return BTreeMap::new();
    };
    let frames = || listing.frames.iter().filter(|frame| frame.present);
    let mut folders = frames().filter_map(|frame| frame.image.parent());
    let first = folders.next().unwrap_or(Path::new(""));
    let common = folders.fold(first, |common, folder| {
        let mut above = common.ancestors();
        let shared = above.find(|above| folder.starts_with(above));
        shared.unwrap_or(Path::new(""))
    });
    let photo = |frame: &Frame| {
        let below = frame.image.strip_prefix(common).unwrap_or(&frame.image);
        let parts: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
        let photo = ViewPhoto {
            file: frame.image.clone(),
            name: parts.join("/"),
            size: (frame.camera.width, frame.camera.height),
            is_pinhole: frame.lens.is_pinhole(),
        };
        (frame.name.clone(), photo)
    };
    frames().map(photo).collect()
}
