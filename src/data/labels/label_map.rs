//! Label maps as grey PNG files, 8 or 16 bits a pixel: the value is the class id.

use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Limits, atomic};
use crate::error::{Error, Result};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io;
use std::path::Path;

/// What datasets and segmenters write for pixels that count for nothing (Cityscapes, ADE20K, mmsegmentation).
const USUALLY_IGNORED: u16 = 255;

impl LabelMap {
    /// Reads a grey PNG of 8 or 16 bits.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] when the file is not a complete PNG or holds colours instead of ids.
    pub fn read(path: &Path, limits: &Limits) -> Result<Self> {
        Self::decode(path, &ImageFile::open(path, limits)?)
    }

    /// Refuses ids other than those of `classes`, whose lookup `known` is, and the ignored one. [`USUALLY_IGNORED`] becomes that one
    /// where no class has it. `or` is added to what mends it.
    pub(crate) fn settle_ids(
        &mut self,
        path: &Path,
        classes: &Classes,
        known: &[u16],
        or: &str,
    ) -> Result<()> {
        if known[usize::from(USUALLY_IGNORED)] == u16::MAX {
            let ignored = self.ids.iter_mut().filter(|id| **id == USUALLY_IGNORED);
            ignored.for_each(|id| *id = classes.ignore);
        }
        let unknown = |&id: &u16| id != classes.ignore && known[usize::from(id)] == u16::MAX;
        let Some(i) = self.ids.iter().position(unknown) else {
            return Ok(());
        };
        let mut found: Vec<u16> = self.ids.iter().copied().filter(|id| unknown(id)).collect();
        found.sort_unstable();
        found.dedup();
        let more = match &found[..] {
            [_] => String::new(),
            all => format!(", and {} other unknown ids", all.len() - 1),
        };
        let ids: Vec<_> = classes.entries.iter().map(|c| c.id.to_string()).collect();
        Err(Error::input(
            path,
            self.pixel(i),
            format!("label id {}{more}", self.ids[i]),
            format!(
                "{} (ignored) or one of the {} class ids [{}]",
                classes.ignore,
                ids.len(),
                ids.join(" ")
            ),
            format!("add the id to classes.json or correct the map{or}"),
        ))
    }

    /// Replaces ids by what `table` (length 65536) has for them.
    pub(crate) fn translate(&mut self, path: &Path, table: &[u32]) -> Result<()> {
        for i in 0..self.ids.len() {
            let id = self.ids[i];
            self.ids[i] = u16::try_from(table[usize::from(id)]).map_err(|_| {
                let expected = "an id of the dataset's table of labels";
                let help = "use the table that belongs to these label maps, or correct the map";
                Error::input(
                    path,
                    self.pixel(i),
                    format!("label id {id}"),
                    expected,
                    help,
                )
            })?;
        }
        Ok(())
    }

    fn pixel(&self, i: usize) -> String {
        format!("pixel x {}, y {}", i % self.width, i / self.width)
    }

    pub(crate) fn decode(path: &Path, file: &ImageFile) -> Result<Self> {
        let grey = "a grey PNG of 8 or 16 bits whose values are class ids";
        let reject =
            |found: &str, help: &str| Err(Error::input(path, "pixel format", found, grey, help));
        match file.png_color() {
            None => return reject("JPEG", "save the ids as PNG: JPEG compression changes them"),
            Some((8 | 16, 0)) => {}
            Some((bits, 0)) => {
                return reject(&format!("{bits}-bit grey"), "save it with 8 bits a pixel");
            }
            Some((_, 3)) => {
                return reject(
                    "a palette PNG",
                    "save the palette indices as grey; in Python: Image.fromarray(np.array(Image.open(path)))",
                );
            }
            Some(_) => {
                return reject(
                    "a PNG with colours or alpha",
                    "map each colour to its class id and save as grey",
                );
            }
        }
        let (width, height) = file.size;
        let ids = match file.decode()? {
            DynamicImage::ImageLuma8(image) => {
                image.into_raw().into_iter().map(u16::from).collect()
            }
            DynamicImage::ImageLuma16(image) => image.into_raw(),
            // The header says grey of 8 or 16 bits; a transparency chunk adds alpha.
            _ => {
                return reject(
                    "a grey PNG with transparency",
                    "save it without transparency",
                );
            }
        };
        Ok(Self { width, height, ids })
    }

    /// Writes a grey PNG: 8 bits when every id fits, else 16.
    ///
    /// # Errors
    /// [`Error::Io`], also when `ids` does not fill `width` x `height`.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.write_as(path, self.ids.iter().any(|&id| id > 255))
    }

    /// Writes a grey PNG of 16 bits, whatever the ids are.
    ///
    /// # Errors
    /// As [`LabelMap::write`].
    pub fn write_wide(&self, path: &Path) -> Result<()> {
        self.write_as(path, true)
    }

    fn write_as(&self, path: &Path, wide: bool) -> Result<()> {
        let (bytes, color): (Vec<u8>, _) = if wide {
            // The encoder takes 16-bit samples in the machine's own order.
            (
                self.ids.iter().flat_map(|id| id.to_ne_bytes()).collect(),
                ExtendedColorType::L16,
            )
        } else {
            (
                self.ids.iter().map(|&id| id as u8).collect(),
                ExtendedColorType::L8,
            )
        };
        let size = u32::try_from(self.width)
            .ok()
            .zip(u32::try_from(self.height).ok());
        let fits = size.filter(|_| Some(self.ids.len()) == self.width.checked_mul(self.height));
        atomic::write(path, |out| {
            let (w, h) = fits.ok_or_else(|| io::Error::other("label ids do not fill the image"))?;
            PngEncoder::new(out)
                .write_image(&bytes, w, h, color)
                .map_err(io::Error::other)
        })
    }
}
