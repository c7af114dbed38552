//! Masks of photos: black where COLMAP and training leave a photo out.

use super::photos::{Photo, Photos, turned};
use crate::data::LabelMap;
use crate::data::formats::{label_folder, mask_file};
use crate::data::photos::image_file::{ImageFile, proportional};
use crate::error::{Error, Result, ensure, in_order};
use crate::files::{atomic, file_name};
use crate::progress::{Progress, Viewing};
use image::imageops::FilterType;
use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, ImageFormat};
use rayon::prelude::*;
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
            let help = "name the folder of the masks";
            return Err(Error::missing("folder", dir, help));
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

    /// Reads the masks of `photos` before anything is written. Warns of masks that may be turned.
    ///
    /// # Errors
    /// [`Error::Input`] for a mask of other proportions, or one that cannot be read; [`Error::Io`]; [`Error::Stopped`].
    pub fn check(&self, photos: &Photos, progress: &mut dyn Progress) -> Result<()> {
        let masked = |photo| Some((photo, self.of(photo)?));
        let masked: Vec<(&Photo, &Path)> = photos.all.iter().filter_map(masked).collect();
        let mut viewing = Viewing::begin(progress, "masks", masked.len());
        for some in masked.chunks(rayon::current_num_threads()) {
            in_order(some.par_iter().map(|(photo, file)| {
                let upright = turned(photo.size, photos.turn(photo));
                decode(file, photo.size, upright).map(drop)
            }))?;
            viewing.advance(some.len())?;
        }
        viewing.end();
        let untraced = masked
            .iter()
            .filter(|(photo, _)| photo.turns_without_trace());
        if let [(first, _), ..] = untraced.collect::<Vec<_>>()[..] {
            tracing::warn!(
                "{}: its EXIF orientation turns it, but its size does not show that; its mask is assumed to lie as \
                 the photo is stored, and so are those of other such photos",
                first.path.display()
            );
        }
        Ok(())
    }

    /// The mask of `photo`, where one is given.
    fn of(&self, photo: &Photo) -> Option<&Path> {
        self.0.get(&photo.path).map(PathBuf::as_path)
    }

    /// Writes the mask of `photo` into `out` as a grey PNG of its size, 0 or 255, turned as the photo is by `turn`. White for a photo
    /// without a mask, which COLMAP would leave out.
    ///
    /// # Errors
    /// As for [`Masks::check`].
    pub fn write(&self, photo: &Photo, turn: Option<Orientation>, out: &Path) -> Result<()> {
        let size = turned(photo.size, turn);
        let mask = match self.of(photo) {
            None => GrayImage::from_pixel(size.0 as u32, size.1 as u32, [u8::MAX].into()).into(),
            Some(file) => read(file, photo.size, turn)?,
        };
        let mut png = Cursor::new(Vec::new());
        let written = mask.write_to(&mut png, ImageFormat::Png);
        let name = format!("{}.png", file_name(&photo.path).unwrap_or_default());
        let path = out.join(name);
        written.map_err(|e| Error::io(&path, "encode", std::io::Error::other(e)))?;
        atomic::write_bytes(path, &png.into_inner())
    }
}

/// Decodes the mask in `file` of a photo that has the size `stored` in its file, and `upright` after it was turned. The mask is 0
/// where the photo is left out. The flag is true where the mask lies as the photo is stored, and false where it fits the turned
/// photo alone.
fn decode(
    file: &Path,
    stored: (usize, usize),
    upright: (usize, usize),
) -> Result<(LabelMap, bool)> {
    let image = ImageFile::open(file)?;
    let size = image.size;
    let is_stored = size == stored || size != upright && proportional(size, stored);
    ensure!(is_stored || proportional(size, upright), file, "size"; found "{}x{} pixels", size.0, size.1;
        expected "{}x{}, as its photo, or a size of the same proportions", stored.0, stored.1;
        help "make the mask of the whole photo, neither cut nor turned");
    Ok((mask_file::decode(file, &image)?, is_stored))
}

/// The mask in `file` of a photo of the size `stored`, turned as the photo is by `turn`: 0 or 255.
fn read(file: &Path, stored: (usize, usize), turn: Option<Orientation>) -> Result<DynamicImage> {
    let upright = turned(stored, turn);
    let (used, is_stored) = decode(file, stored, upright)?;
    let place = |x: u32, y: u32| y as usize * used.width + x as usize;
    let mut mask: DynamicImage =
        GrayImage::from_fn(used.width as u32, used.height as u32, |x, y| {
            let is_used = used.ids[place(x, y)] != 0;
            [if is_used { u8::MAX } else { 0 }].into()
        })
        .into();
    if let Some(turn) = turn.filter(|_| is_stored) {
        mask.apply_orientation(turn);
    }
    Ok(mask.resize_exact(upright.0 as u32, upright.1 as u32, FilterType::Nearest))
}
