//! Masks of photos as PNG files: black pixels are left out, all others are used.

use crate::config::{Layout, NO_MASKS, same_folder};
use crate::data::formats::frame::{Frame, Geometry, proportional};
use crate::data::formats::listing::{LabelFolder, Problems};
use crate::data::mask::Mask;
use crate::data::photos::image_file::ImageFile;
use crate::data::{LabelMap, Limits, LoadOptions};
use crate::error::{Error, Result};
use image::DynamicImage;
use std::path::{Path, PathBuf};

/// The folder of masks of a COLMAP project.
const USUAL: &str = "masks";

/// Where the masks of a scene folder lie.
pub(crate) enum Masks {
    /// Nowhere: photos are used whole.
    Off,
    /// Where the frames say.
    OfFrames,
    /// In a folder, by the names of their photos.
    In(PathBuf),
}

/// The folder of masks that is looked into: the one that the user names, or the usual one of the layout, where it is there and holds
/// neither photos nor raw labels.
pub(crate) fn folder_name<'a>(
    dir: &Path,
    options: &'a LoadOptions,
    layout: Layout,
) -> Option<&'a str> {
    let taken = [Some(&options.images), options.raw_labels.as_ref()];
    let usual = || {
        layout == Layout::Colmap
            && !taken
                .into_iter()
                .flatten()
                .any(|name| is_folder(dir, name, USUAL))
    };
    let name = match options.masks.as_deref() {
        Some(NO_MASKS) => None,
        Some(name) => Some(name),
        None => usual().then_some(USUAL),
    };
    name.filter(|name| dir.join(name).is_dir())
}

/// Whether two names are of one folder within `dir`, links followed.
fn is_folder(dir: &Path, a: &str, b: &str) -> bool {
    let real = |name: &str| dir.join(name).canonicalize();
    same_folder(a, b) || matches!((real(a), real(b)), (Ok(a), Ok(b)) if a == b)
}

impl Masks {
    /// As the user says, or else the layout. A folder that is named and not there is a fault, and photos are then used whole.
    pub fn of(dir: &Path, options: &LoadOptions, layout: Layout, problems: &mut Problems) -> Self {
        match (folder_name(dir, options, layout), options.masks.as_deref()) {
            (Some(name), _) => Self::In(dir.join(name)),
            (None, None) => Self::OfFrames,
            (None, Some(NO_MASKS)) => Self::Off,
            (None, Some(name)) => {
                let expected = "a folder of masks within the scene folder: PNG, black where a photo is left out";
                let help = format!(
                    "name the folder that holds them with data.masks, leave that out, or turn masks off with data.masks={NO_MASKS}"
                );
                problems.push(Error::input(dir, name, "no such folder", expected, help));
                Self::Off
            }
        }
    }

    /// The mask of the photo that lies at `photo` below the folder of photos, in a layout whose frames name none.
    pub fn of_photo(&self, photo: &Path) -> Option<PathBuf> {
        match self {
            Self::Off | Self::OfFrames => None,
            Self::In(folder) => LabelFolder::in_folder(folder.clone()).file_of(photo),
        }
    }
}

impl Frame {
    /// What the mask of the frame uses, as the view's camera sees it; nothing where it leaves nothing out.
    pub fn read_mask(&self, geometry: &Geometry, limits: &Limits) -> Result<Option<Mask>> {
        let Some(path) = &self.mask else {
            return Ok(None);
        };
        if !path.is_file() {
            let help = "put the mask there, or do not name it".into();
            return Err(Error::Missing {
                what: "file",
                path: path.clone(),
                help,
            });
        }
        let file = ImageFile::open(path, limits)?;
        let (w, h) = (geometry.camera.width, geometry.camera.height);
        if !geometry.is_as_seen(file.size) && !proportional(file.size, (w, h)) {
            let found = format!("{}x{} pixels", file.size.0, file.size.1);
            let expected = format!("{w}x{h}, as its photo, or a size of the same proportions");
            let help = "make the mask of the whole photo as it lies there, neither cut nor turned";
            return Err(Error::input(path, "size", found, expected, help));
        }
        let LabelMap { width, height, ids } = geometry.labels_of_photo(decode(path, &file)?);
        let mask = Mask::new(width, height, |pixel| ids[pixel] != 0);
        if mask.left_out() == width * height {
            let found = "all pixels of the view are black";
            let expected = "black where the photo is left out, and another value in the rest";
            let help = "invert masks that are white where the photo is left out, or drop the frame";
            return Err(Error::input(path, "pixels", found, expected, help));
        }
        Ok((mask.left_out() > 0).then_some(mask))
    }
}

/// A mask of the size of its file: 0 where it is black or wholly transparent, else 1.
fn decode(path: &Path, file: &ImageFile) -> Result<LabelMap> {
    if file.png_color().is_none() {
        let help = "save the mask as PNG: JPEG compression changes what is black";
        return Err(Error::input(
            path,
            "pixel format",
            "JPEG",
            "a PNG, black where the photo is left out",
            help,
        ));
    }
    let (width, height) = file.size;
    let ids = match file.decode()? {
        DynamicImage::ImageLuma8(image) => image
            .into_raw()
            .into_iter()
            .map(|v| u16::from(v > 0))
            .collect(),
        image => {
            let used = |[r, g, b, a]: [u16; 4]| u16::from(a > 0 && (r > 0 || g > 0 || b > 0));
            image
                .into_rgba16()
                .pixels()
                .map(|pixel| used(pixel.0))
                .collect()
        }
    };
    Ok(LabelMap { width, height, ids })
}

impl LabelMap {
    /// The map with `id` in all pixels that `mask`, of the same size, leaves out.
    pub(crate) fn without(mut self, mask: Option<&Mask>, id: u16) -> Self {
        if let Some(mask) = mask {
            mask.fill(&mut self.ids, 1, id);
        }
        self
    }
}
