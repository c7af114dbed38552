//! Label maps as grey PNG files, 8 or 16 bits a pixel: the value is the class id.

use crate::data::Classes;
use crate::data::photos::image_file::ImageFile;
use crate::error::{Error, Result, bail, invalid};
use crate::files::{atomic, check_limit, file_name};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, codecs::png::PngEncoder};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

/// The id that datasets and segmenters write for unlabelled pixels (Cityscapes, ADE20K, mmsegmentation).
const USUALLY_IGNORED: u16 = 255;

/// Label ids of an image, `[H, W]` row-major. Ids are those of the [`Classes`] table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LabelMap {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Row-major ids, length `width * height`.
    pub ids: Vec<u16>,
}

impl LabelMap {
    /// Reads a grey PNG of 8 or 16 bits.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] when the file is not a complete PNG or holds colours instead of ids.
    pub fn read(path: &Path) -> Result<Self> {
        Self::decode(path, &ImageFile::open(path)?)
    }

    /// Refuses ids other than those of `classes` and the ignored id; without classes no id can be wrong. [`USUALLY_IGNORED`] becomes the
    /// ignored id where no class has it. `or` is added to the help.
    pub(crate) fn check_ids(&mut self, path: &Path, classes: &Classes, or: &str) -> Result<()> {
        if classes.is_empty() {
            return Ok(());
        }
        let known = classes.lookup();
        let is_class = |id: u16| known[usize::from(id)] != u16::MAX;
        if !is_class(USUALLY_IGNORED) {
            let ignored = self.ids.iter_mut().filter(|id| **id == USUALLY_IGNORED);
            ignored.for_each(|id| *id = classes.ignore);
        }
        let is_unknown = |id: u16| id != classes.ignore && !is_class(id);
        let Some(i) = self.ids.iter().position(|id| is_unknown(*id)) else {
            return Ok(());
        };
        let ids = self.ids.iter().copied();
        let unknown: BTreeSet<u16> = ids.filter(|id| is_unknown(*id)).collect();
        let more = match unknown.len() - 1 {
            0 => String::new(),
            more => format!(", and {more} other unknown ids"),
        };
        let ids: Vec<_> = classes.entries.iter().map(|c| c.id.to_string()).collect();
        bail!(path, "{}", self.pixel(i); found "label id {}{more}", self.ids[i];
            expected "{} (ignored) or one of the {} class ids [{}]", classes.ignore, ids.len(), ids.join(" ");
            help "add the id to classes.json or correct the map{or}");
    }

    /// Nearest ids at `place(u, v)` for each of `width` x `height` pixels; `place` gives shares of this map's width and
    /// height for pixel coordinates.
    pub(crate) fn sampled(
        &self,
        width: usize,
        height: usize,
        place: impl Fn(f64, f64) -> (f64, f64),
    ) -> Self {
        let nearest =
            |share: f64, length: usize| ((share * length as f64).max(0.0) as usize).min(length - 1);
        let mut ids = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let (x, y) = place(column as f64 + 0.5, row as f64 + 0.5);
                ids.push(self.ids[nearest(y, self.height) * self.width + nearest(x, self.width)]);
            }
        }
        Self { width, height, ids }
    }

    /// The map at another size, nearest.
    pub(crate) fn resized(self, width: usize, height: usize) -> Self {
        if (self.width, self.height) == (width, height) {
            return self;
        }
        self.sampled(width, height, |u, v| (u / width as f64, v / height as f64))
    }

    /// Replaces ids by their entries in `table` (length 65536).
    pub(crate) fn translate(&mut self, path: &Path, table: &[Option<u16>]) -> Result<()> {
        for i in 0..self.ids.len() {
            let id = self.ids[i];
            self.ids[i] = table[usize::from(id)].ok_or_else(|| {
                invalid!(path, "{}", self.pixel(i); found "label id {id}";
                    expected "an id of the dataset's table of labels";
                    help "use the table that belongs to these label maps, or correct the map")
            })?;
        }
        Ok(())
    }

    /// The pixels that share a side with `pixel`.
    pub(crate) fn beside(&self, pixel: usize) -> impl Iterator<Item = usize> {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let sides = [
            (x > 0).then(|| pixel - 1),
            (x + 1 < self.width).then(|| pixel + 1),
            (y > 0).then(|| pixel - self.width),
            (y + 1 < self.height).then(|| pixel + self.width),
        ];
        sides.into_iter().flatten()
    }

    /// The pixels of each region, breadth first from its first pixel, in the order of these first pixels. Pixels of a region are
    /// `alike` and connected by their sides.
    pub(crate) fn regions(&self, alike: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.ids.len()];
        let mut regions = Vec::new();
        for first in 0..seen.len() {
            if seen[first] {
                continue;
            }
            seen[first] = true;
            let mut pixels = vec![first];
            let mut at = 0;
            while let Some(&pixel) = pixels.get(at) {
                at += 1;
                for next in self.beside(pixel) {
                    if !seen[next] && alike(pixel, next) {
                        seen[next] = true;
                        pixels.push(next);
                    }
                }
            }
            regions.push(pixels);
        }
        regions
    }

    /// The number among the regions of one id that each pixel belongs to.
    pub(crate) fn region_numbers(&self) -> Vec<u32> {
        let mut numbers = vec![0; self.ids.len()];
        let regions = self.regions(|a, b| self.ids[a] == self.ids[b]);
        for (region, number) in regions.iter().zip(0..) {
            region.iter().for_each(|&pixel| numbers[pixel] = number);
        }
        numbers
    }

    fn pixel(&self, i: usize) -> String {
        format!("pixel x {}, y {}", i % self.width, i / self.width)
    }

    pub(crate) fn decode(path: &Path, file: &ImageFile) -> Result<Self> {
        let (found, help) = match file.png_color() {
            Some((8 | 16, 0)) => (
                "a grey PNG with transparency",
                "save it without transparency",
            ),
            Some((_, 0)) => ("grey of less than 8 bits", "save it with 8 bits a pixel"),
            Some((_, 3)) => (
                "a palette PNG",
                "save the palette indices as grey; in Python: Image.fromarray(np.array(Image.open(path)))",
            ),
            Some(_) => (
                "a PNG with colours or alpha",
                "map each colour to its class id and save as grey",
            ),
            None => ("JPEG", "save the ids as PNG: JPEG compression changes them"),
        };
        let (width, height) = file.size;
        let is_grey = matches!(file.png_color(), Some((8 | 16, 0)));
        let ids = match is_grey.then(|| file.decode()).transpose()? {
            Some(DynamicImage::ImageLuma8(image)) => {
                image.into_raw().into_iter().map(u16::from).collect()
            }
            Some(DynamicImage::ImageLuma16(image)) => image.into_raw(),
            // A transparency chunk adds alpha to grey.
            _ => {
                bail!(path, "pixel format"; found "{found}";
                    expected "a grey PNG of 8 or 16 bits whose values are class ids"; help "{help}");
            }
        };
        Ok(Self { width, height, ids })
    }

    /// Writes a grey PNG: 8 bits when every id fits, else 16.
    ///
    /// # Errors
    /// [`crate::Error::Io`], also when `ids` does not fill `width` x `height`.
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

    /// Writes a PNG of 8 bits with a palette: the value of a pixel is its id, `color` the palette.
    ///
    /// # Errors
    /// [`crate::Error::Limit`] for ids above 255; [`crate::Error::Io`].
    pub fn write_indexed(&self, path: &Path, color: impl Fn(u16) -> [u8; 3]) -> Result<()> {
        let most = self.ids.iter().copied().max().unwrap_or_default();
        let help = "a palette has no more colours; take the grey maps";
        check_limit(path, "label id", most.into(), 255, help)?;
        let palette: Vec<u8> = (0..=most).flat_map(color).collect();
        let ids: Vec<u8> = self.ids.iter().map(|&id| id as u8).collect();
        atomic::write(path, |out| {
            let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(palette);
            let mut writer = encoder.write_header()?;
            Ok(writer.write_image_data(&ids)?)
        })
    }

    /// The bytes of the file that [`LabelMap::write`] writes.
    pub(crate) fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let encoded = self.encode(&mut bytes, self.ids.iter().any(|&id| id > 255));
        encoded.map_err(|e| Error::io("label map", "encode", e))?;
        Ok(bytes)
    }

    fn write_as(&self, path: &Path, wide: bool) -> Result<()> {
        atomic::write(path, |out| self.encode(out, wide))
    }

    fn encode(&self, out: impl Write, wide: bool) -> io::Result<()> {
        let (width, height) = (self.width as u32, self.height as u32);
        let wrong_size = || io::Error::other("label ids do not fill the image");
        let encoder = PngEncoder::new(out);
        let written = if wide {
            let image = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, &self.ids[..]);
            image.ok_or_else(wrong_size)?.write_with_encoder(encoder)
        } else {
            let ids = self.ids.iter().map(|&id| id as u8).collect();
            GrayImage::from_raw(width, height, ids)
                .ok_or_else(wrong_size)?
                .write_with_encoder(encoder)
        };
        written.map_err(io::Error::other)
    }
}

impl AsRef<[u16]> for LabelMap {
    fn as_ref(&self) -> &[u16] {
        &self.ids
    }
}

/// Refuses a label map of `photo` that is not there.
pub(crate) fn expect_file(path: &Path, photo: &Path) -> Result<()> {
    if path.is_file() {
        return Ok(());
    }
    let jpegs = ["jpg", "jpeg", "JPG", "JPEG"].map(|extension| path.with_extension(extension));
    let jpeg = jpegs.iter().find(|jpeg| jpeg.is_file() && *jpeg != photo);
    let help = match jpeg.and_then(|jpeg| file_name(jpeg)) {
        // Faults that differ in brackets alone are of one kind.
        Some(jpeg) => {
            format!("save it as PNG, as JPEG changes the ids ({jpeg} is there), or do not name it")
        }
        None => "put the label map there, or do not name it".to_owned(),
    };
    Err(Error::missing("file", path, help))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_connected_parts_of_one_id() {
        let map = LabelMap {
            width: 4,
            height: 3,
            ids: vec![1, 1, 2, 1, 2, 1, 2, 1, 2, 2, 2, 1],
        };
        assert_eq!(map.region_numbers(), [0, 0, 1, 2, 1, 0, 1, 2, 1, 1, 1, 2]);
        let all = map.regions(|_, _| true);
        assert_eq!(all, [[0, 1, 4, 2, 5, 8, 3, 6, 9, 7, 10, 11]]);
        assert!(LabelMap::default().region_numbers().is_empty());
    }
}
