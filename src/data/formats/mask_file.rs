//! Masks of photos as PNG files: black pixels are left out, all others are used.

use super::folder::{Folder, Problems};
use super::frame::{Frame, Geometry};
use super::label_folder::{file, names};
use crate::config::{Layout, NO_MASKS, same_folder};
use crate::data::LabelMap;
use crate::data::mask::Mask;
use crate::data::photos::image_file::{ImageFile, proportional};
use crate::error::{Error, Result, bail, ensure, invalid};
use std::path::{Path, PathBuf};

/// The folder of masks of a COLMAP project.
const COLMAP_MASKS: &str = "masks";

/// Where the masks of a scene folder lie.
pub(crate) enum Masks {
    /// Nowhere: photos are used whole.
    Off,
    /// Where the frames say.
    OfFrames,
    /// In a folder, by the names of their photos.
    In(PathBuf),
}

/// The folder of masks, where it exists: the user's, or the usual folder of the layout if it holds neither photos nor raw labels.
pub(crate) fn folder_name<'a>(folder: Folder<'a>) -> Option<&'a str> {
    let Folder { dir, options, .. } = folder;
    let mut taken = [Some(&options.images), options.raw_labels.as_ref()]
        .into_iter()
        .flatten();
    let name = match options.masks.as_deref() {
        Some(NO_MASKS) => None,
        Some(name) => Some(name),
        None if folder.layout != Layout::Colmap
            || taken.any(|name| is_folder(dir, name, COLMAP_MASKS)) =>
        {
            None
        }
        None => Some(COLMAP_MASKS),
    };
    name.filter(|name| dir.join(name).is_dir())
}

/// A notice on the usual folder of masks of COLMAP where another layout has it, and nothing in it is used by `frames`.
pub(crate) fn unused_folder(folder: Folder<'_>, frames: &[Frame]) -> Option<String> {
    let Folder { dir, options, .. } = folder;
    let masks = dir.join(COLMAP_MASKS);
    let raw = options.raw_labels.as_deref();
    let is_used = folder.layout == Layout::Colmap
        || options.masks.is_some()
        || raw.is_some_and(|raw| is_folder(dir, raw, COLMAP_MASKS))
        || frames
            .iter()
            .any(|frame| frame.maps().any(|map| map.starts_with(&masks)));
    (!is_used && masks.is_dir()).then(|| {
        format!(
            "{COLMAP_MASKS}/ is there and not used: --set data.masks={COLMAP_MASKS} uses it, data.masks={NO_MASKS} says that it \
             is not needed"
        )
    })
}

/// Whether two names lead to one folder within `dir`, links followed.
fn is_folder(dir: &Path, a: &str, b: &str) -> bool {
    let real = |name: &str| dir.join(name).canonicalize();
    same_folder(a, b) || matches!((real(a), real(b)), (Ok(a), Ok(b)) if a == b)
}

impl Masks {
    /// The masks that the user names, or else those of the layout. A named folder that does not exist is a fault; photos are then
    /// used whole.
    pub fn new(folder: Folder<'_>, problems: &mut Problems) -> Self {
        let dir = folder.dir;
        match (folder_name(folder), folder.options.masks.as_deref()) {
            (Some(name), _) => Self::In(dir.join(name)),
            (None, None) => Self::OfFrames,
            (None, Some(NO_MASKS)) => Self::Off,
            (None, Some(name)) => {
                problems.push(invalid!(dir, "{name}"; found "no such folder";
                    expected "a folder of masks within the scene folder: PNG, black where a photo is left out";
                    help "name the folder that holds them with data.masks, leave that out, or turn masks off with \
                        data.masks={NO_MASKS}"));
                Self::Off
            }
        }
    }

    /// The mask of the photo that lies at `photo` below the folder of photos, in a layout whose frames name none.
    pub fn of_photo(&self, photo: &Path) -> Option<PathBuf> {
        match self {
            Self::Off | Self::OfFrames => None,
            Self::In(folder) => file(&names(folder, photo)),
        }
    }
}

impl Frame {
    /// The mask of the frame as the view's camera sees it; `None` where it leaves nothing out.
    pub fn read_mask(&self, geometry: &Geometry) -> Result<Option<Mask>> {
        let Some(path) = &self.mask else {
            return Ok(None);
        };
        if !path.is_file() {
            let help = "put the mask there, or do not name it";
            return Err(Error::missing("file", path, help));
        }
        let file = ImageFile::open(path)?;
        let size = (geometry.camera.width, geometry.camera.height);
        if !geometry.is_reduced_size(file.size) && !proportional(file.size, size) {
            bail!(path, "size"; found "{}x{} pixels", file.size.0, file.size.1;
                expected "{}x{}, as its photo, or a size of the same proportions", size.0, size.1;
                help "make the mask of the whole photo as it is stored, neither cut nor turned");
        }
        let LabelMap { width, height, ids } = geometry.labels_of_photo(decode(path, &file)?);
        let mask = Mask::new(width, height, |pixel| ids[pixel] != 0);
        ensure!(mask.left_out() != width * height, path, "pixels"; found "all pixels of the view are black";
            expected "black where the photo is left out, and another value in the rest";
            help "invert masks that are white where the photo is left out, or drop the frame");
        Ok((mask.left_out() > 0).then_some(mask))
    }
}

/// A mask of the size of its file: 0 where it is black or wholly transparent, else 1.
pub(crate) fn decode(path: &Path, file: &ImageFile) -> Result<LabelMap> {
    if file.png_color().is_none() {
        bail!(path, "pixel format"; found "JPEG"; expected "a PNG, black where the photo is left out";
            help "save the mask as PNG: JPEG compression changes what is black");
    }
    let (width, height) = file.size;
    let pixels = file.decode()?.into_rgba16();
    let used = |[r, g, b, a]: [u16; 4]| u16::from(a > 0 && (r > 0 || g > 0 || b > 0));
    let ids = pixels.pixels().map(|pixel| used(pixel.0)).collect();
    Ok(LabelMap { width, height, ids })
}
