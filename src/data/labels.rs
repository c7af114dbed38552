//! Label maps as grey PNG files, 8 or 16 bits a pixel: the value is the class id.

use super::image_file::ImageFile;
use super::{Classes, LabelMap, Limits, atomic};
use crate::error::{Error, Result};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io;
use std::path::Path;

impl LabelMap {
    /// Reads a grey PNG of 8 or 16 bits.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] when the file is not a complete PNG or holds colours instead of ids.
    pub fn read(path: &Path, limits: &Limits) -> Result<Self> {
        Self::decode(path, &ImageFile::open(path, limits)?)
    }

    /// Reads a label map that must have this size and hold no id but those of `classes` and the ignored one.
    pub(super) fn read_checked(
        path: &Path,
        (width, height): (usize, usize),
        classes: &Classes,
        known: &[u16],
        limits: &Limits,
    ) -> Result<Self> {
        let file = ImageFile::open(path, limits)?;
        file.expect_size(width, height, "its photo")?;
        let map = Self::decode(path, &file)?;
        let unknown = |&id: &u16| id != classes.ignore && known[usize::from(id)] == u16::MAX;
        if let Some(i) = map.ids.iter().position(unknown) {
            let ids: Vec<_> = classes.entries.iter().map(|c| c.id.to_string()).collect();
            return Err(Error::input(
                path,
                format!("pixel x {}, y {}", i % width, i / width),
                format!("label id {}", map.ids[i]),
                format!("{} (ignored) or one of the {} class ids [{}]", classes.ignore, ids.len(), ids.join(" ")),
                "add the id to classes.json or mend the map",
            ));
        }
        Ok(map)
    }

    fn decode(path: &Path, file: &ImageFile) -> Result<Self> {
        let grey = "a grey PNG of 8 or 16 bits whose values are class ids";
        let reject = |found: &str, mend: &str| Err(Error::input(path, "pixel format", found, grey, mend));
        match file.png_color() {
            None => return reject("JPEG", "save the ids as PNG: JPEG compression changes them"),
            Some((8 | 16, 0)) => {}
            Some((bits, 0)) => return reject(&format!("{bits}-bit grey"), "save it with 8 bits a pixel"),
            Some((_, 3)) => {
                return reject(
                    "a palette PNG",
                    "save the palette indices as grey; in Python: Image.fromarray(np.array(Image.open(path)))",
                );
            }
            Some(_) => {
                return reject("a PNG with colours or alpha", "map each colour to its class id and save as grey");
            }
        }
        let (width, height) = file.size;
        let ids = match file.decode()? {
            DynamicImage::ImageLuma8(image) => image.into_raw().into_iter().map(u16::from).collect(),
            DynamicImage::ImageLuma16(image) => image.into_raw(),
            // The header says grey of 8 or 16 bits; a transparency chunk adds alpha.
            _ => return reject("a grey PNG with transparency", "save it without transparency"),
        };
        Ok(Self { width, height, ids })
    }

    /// Writes a grey PNG: 8 bits when every id fits, else 16.
    ///
    /// # Errors
    /// [`Error::Io`], also when `ids` does not fill `width` x `height`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let wide = self.ids.iter().any(|&id| id > 255);
        let (bytes, color): (Vec<u8>, _) = if wide {
            // The encoder takes 16-bit samples in the machine's own order.
            (self.ids.iter().flat_map(|id| id.to_ne_bytes()).collect(), ExtendedColorType::L16)
        } else {
            (self.ids.iter().map(|&id| id as u8).collect(), ExtendedColorType::L8)
        };
        let size = u32::try_from(self.width).ok().zip(u32::try_from(self.height).ok());
        let fits = size.filter(|_| Some(self.ids.len()) == self.width.checked_mul(self.height));
        atomic::write(path, |out| {
            let (w, h) = fits.ok_or_else(|| io::Error::other("label ids do not fill the image"))?;
            PngEncoder::new(out).write_image(&bytes, w, h, color).map_err(io::Error::other)
        })
    }
}
