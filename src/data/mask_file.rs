//! Masks of photos as PNG files: black pixels are left out, all others are used.

use super::frame::{Frame, Geometry, proportional};
use super::image_file::ImageFile;
use super::listing::{LabelFolder, Listing};
use super::{LabelMap, Limits, LoadOptions};
use crate::error::{Error, Result};
use crate::mask::Mask;
use image::DynamicImage;
use std::path::Path;

/// The folder of masks of a COLMAP project.
pub(super) const USUAL: &str = "masks";

/// The folder of masks that the user names, which has to be there, or else `usual`, where it is there.
pub(super) fn folder(dir: &Path, options: &LoadOptions, usual: Option<&str>) -> Result<Option<LabelFolder>> {
    let name = options.masks.as_deref();
    if let Some(name) = name.filter(|name| !dir.join(name).is_dir()) {
        let expected = "a folder of masks within the scene folder: PNG, black where a photo is left out";
        let mend = "name the folder that holds them with data.masks, or leave that out";
        return Err(Error::input(dir, name, "no such folder", expected, mend));
    }
    Ok(name.or(usual).map(|name| LabelFolder::optional(dir, name)))
}

impl Listing {
    /// What the mask of a frame uses, as the view's camera sees it; nothing where it leaves nothing out.
    pub fn mask(&self, frame: &Frame, geometry: &Geometry, limits: &Limits) -> Result<Option<Mask>> {
        let Some(path) = &frame.mask else { return Ok(None) };
        if !path.is_file() {
            let mend = "put the mask there, or do not name it".into();
            return Err(Error::Missing { what: "file", path: path.clone(), mend });
        }
        let file = ImageFile::open(path, limits)?;
        let (w, h) = (geometry.camera.width, geometry.camera.height);
        if !geometry.is_as_seen(file.size) && !proportional(file.size, (w, h)) {
            file.expect_size(w, h, "its photo")?;
        }
        let LabelMap { width, height, ids } = geometry.labels(decode(path, &file)?);
        let mask = Mask::new(width, height, |pixel| ids[pixel] != 0);
        if mask.left_out() == width * height {
            let found = format!("all {width}x{height} pixels of the view are black");
            let expected = "black where the photo is left out, and another value in the rest";
            let mend = "invert masks that are white where the photo is left out, or drop the frame";
            return Err(Error::input(path, "pixels", found, expected, mend));
        }
        Ok((mask.left_out() > 0).then_some(mask))
    }
}

/// A mask of the size of its file: 0 where it is black or wholly transparent, else 1.
fn decode(path: &Path, file: &ImageFile) -> Result<LabelMap> {
    if file.png_color().is_none() {
        let mend = "save the mask as PNG: JPEG compression changes what is black";
        return Err(Error::input(path, "pixel format", "JPEG", "a PNG, black where the photo is left out", mend));
    }
    let (width, height) = file.size;
    let ids = match file.decode()? {
        DynamicImage::ImageLuma8(image) => image.into_raw().into_iter().map(|v| u16::from(v > 0)).collect(),
        image => {
            let used = |[r, g, b, a]: [u16; 4]| u16::from(a > 0 && (r > 0 || g > 0 || b > 0));
            image.into_rgba16().pixels().map(|pixel| used(pixel.0)).collect()
        }
    };
    Ok(LabelMap { width, height, ids })
}

impl LabelMap {
    /// The map with `id` in all pixels that `mask`, of the same size, leaves out.
    pub(super) fn without(mut self, mask: Option<&Mask>, id: u16) -> Self {
        if let Some(mask) = mask {
            mask.fill(&mut self.ids, 1, id);
        }
        self
    }
}
