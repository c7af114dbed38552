//! Masks of photos: black where COLMAP and training leave a photo out.

use crate::data::Limits;
use crate::data::formats::{label_folder, mask_file};
use crate::data::photos::image_file::{ImageFile, proportional};
use crate::error::{Error, Result, ensure};
use crate::files::{atomic, file_name};
use image::imageops::FilterType;
use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, ImageFormat};
use std::collections::HashMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// The masks of a folder, by their photos.
pub(super) struct Masks(pub HashMap<PathBuf, PathBuf>);

impl Masks {
    /// The masks in `dir` that are named as `photos`: `a.png` or `a.jpg.png` for `a.jpg`.
    ///
    /// # Errors
    /// [`Error::Missing`] without the folder; [`Error::Argument`] where no photo has a mask.
    pub fn list(dir: &Path, photos: &[PathBuf]) -> Result<Self> {
        if !dir.is_dir() {
            return Err(Error::missing(
                "folder",
                dir,
                "name the folder of the masks",
            ));
        }
        let mask = |photo: &PathBuf| {
            let name = file_name(photo)?;
            let found = label_folder::file(&label_folder::names(dir, Path::new(&name)))?;
            (found != *photo).then(|| (photo.clone(), found))
        };
        let found: HashMap<_, _> = photos.iter().filter_map(mask).collect();
        ensure!(!found.is_empty(), argument "--masks"; found "{}, which has no mask of any photo", dir.display();
            expected "PNG files named as the photos: a.png or a.jpg.png for a.jpg"; help "rename the masks");
        Ok(Self(found))
    }

    /// Writes the mask of `photo` into `out` as a grey PNG of its size, 0 or 255, turned as the photo is by `orientation`. White for a
    /// photo without a mask, which COLMAP would leave out.
    ///
    /// # Errors
    /// [`Error::Input`] for a mask of other proportions, or one that cannot be read; [`Error::Io`].
    pub fn write(&self, photo: &ImageFile, orientation: Option<u8>, out: &Path) -> Result<()> {
        let (width, height) = photo.size;
        let orientation = orientation.and_then(Orientation::from_exif);
        let mut upright = DynamicImage::new_luma8(width as u32, height as u32);
        orientation.inspect(|turn| upright.apply_orientation(*turn));
        let size = (upright.width(), upright.height());
        let mask = match self.0.get(photo.path()) {
            None => GrayImage::from_pixel(size.0, size.1, [u8::MAX].into()).into(),
            Some(file) => read(file, photo.size, orientation, size)?,
        };
        let mut png = Cursor::new(Vec::new());
        let written = mask.write_to(&mut png, ImageFormat::Png);
        let name = format!("{}.png", file_name(photo.path()).unwrap_or_default());
        let path = out.join(name);
        written.map_err(|e| Error::io(&path, "encode", std::io::Error::other(e)))?;
        atomic::write_bytes(path, &png.into_inner())
    }
}

/// The mask in `file` of a photo of the size `stored` that becomes one of the size `upright` when it is turned: 0 or 255. A mask that
/// has the proportions of the turned photo alone is not turned.
fn read(
    file: &Path,
    stored: (usize, usize),
    orientation: Option<Orientation>,
    upright: (u32, u32),
) -> Result<DynamicImage> {
    let image = ImageFile::open(file, &Limits::default())?;
    let turned = (upright.0 as usize, upright.1 as usize);
    let is_stored = proportional(image.size, stored);
    ensure!(is_stored || proportional(image.size, turned), file, "size";
        found "{}x{} pixels", image.size.0, image.size.1;
        expected "{}x{}, as its photo, or a size of the same proportions", stored.0, stored.1;
        help "make the mask of the whole photo, neither cut nor turned");
    let used = mask_file::decode(file, &image)?;
    let place = |x: u32, y: u32| y as usize * used.width + x as usize;
    let mut mask: DynamicImage =
        GrayImage::from_fn(used.width as u32, used.height as u32, |x, y| {
            let is_used = used.ids[place(x, y)] != 0;
            [if is_used { u8::MAX } else { 0 }].into()
        })
        .into();
    if let Some(orientation) = orientation.filter(|_| is_stored) {
        mask.apply_orientation(orientation);
    }
    Ok(mask.resize_exact(upright.0, upright.1, FilterType::Nearest))
}
