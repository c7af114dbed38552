//! PNG and JPEG files. Incomplete files are refused, because decoders accept files that were cut off.

use super::HEIC_HELP;
use crate::error::{Result, bail, ensure, invalid};
use crate::files::check_pixels;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::metadata::Orientation;
use image::{
    DynamicImage, ImageDecoder, ImageEncoder, ImageError, ImageFormat, ImageReader, ImageResult,
    Rgb, RgbImage,
};
use sha2::{Digest, Sha256};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// How far the proportions of a label map may be from those of its photo when it is resampled: ScanNet's own sizes,
/// 1296x968 and 640x480, differ by 0.4 %.
const MAX_PROPORTION_ERROR: f64 = 0.02;
/// Help for a picture that is turned by 90 degrees.
pub(crate) const TURNED_HELP: &str = "it is turned by 90 degrees: some programs turn photos by their EXIF orientation and others \
    do not; apply it to the photos or strip it (docs/from-photos.md, 1), before COLMAP and the segmenter see them";
/// Help for a picture of another size.
/// Bytes of a pixel while a file is decoded, at most: 16 bits of four channels, and a copy.
const PIXEL_BYTES: u64 = 16;
/// Quality of photos that are rewritten.
const JPEG_QUALITY: u8 = 98;
/// Bytes for all parts of a file that are not pixels.
const EXTRA_BYTES: u64 = 16 << 20;
const DAMAGED_HELP: &str = "copy or export it again";

/// An image file in memory, its header read and its end seen, not yet decoded.
pub(crate) struct ImageFile {
    path: PathBuf,
    bytes: Vec<u8>,
    format: ImageFormat,
    /// Pixels across and down.
    pub size: (usize, usize),
}

impl ImageFile {
    /// Reads `path` and checks that it is a complete PNG or JPEG of an acceptable size.
    pub fn open(path: &Path) -> Result<Self> {
        Self::from_bytes(path, crate::files::read(path)?)
    }

    /// As [`Self::open`], of the `bytes` of an image that the file at `path` holds.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let format = match image::guess_format(&bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            _ if bytes.get(4..8) == Some(b"ftyp") => {
                bail!(path, "format"; found "HEIC, AVIF or a video"; expected "PNG or JPEG"; help "{HEIC_HELP}");
            }
            _ => {
                let start = String::from_utf8_lossy(&bytes[..bytes.len().min(8)])
                    .escape_debug()
                    .to_string();
                bail!(path, "format"; found "a file of {} bytes starting with \"{start}\"", bytes.len();
                    expected "PNG or JPEG"; help "convert it");
            }
        };
        let is_complete = if format == ImageFormat::Png {
            png_is_complete
        } else {
            jpeg_is_complete
        };
        let name = name(format);
        ensure!(is_complete(&bytes), path, "image data"; found "{} bytes without the end of the image", bytes.len();
            expected "a complete {name}"; help "{DAMAGED_HELP}");
        let size = reader(&bytes, format, 0).into_dimensions();
        let (width, height) = size.map_err(
            |e| invalid!(path, "header"; found "{e}"; expected "a valid {name}"; help "{DAMAGED_HELP}"),
        )?;
        let size = (width as usize, height as usize);
        check_pixels(path, size.0, size.1)?;
        Ok(Self {
            path: path.to_owned(),
            bytes,
            format,
            size,
        })
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// SHA-256 of the file.
    pub fn digest(&self) -> [u8; 32] {
        Sha256::digest(&self.bytes).into()
    }

    /// Refuses a photo or label map of a different size than `whose`. `help` is for those that are not turned.
    pub fn expect_size(&self, size: (usize, usize), whose: &str, help: &str) -> Result<()> {
        if self.size == size {
            return Ok(());
        }
        let across = self.lies_across(size);
        let exif = self.exif_orientation().filter(|_| across);
        let exif = exif.map_or(String::new(), |exif| {
            format!(", of EXIF orientation {exif}")
        });
        bail!(&self.path, "size"; found "{}x{} pixels{exif}", self.size.0, self.size.1;
            expected "{}x{}, as {whose}", size.0, size.1; help "{}", if across { TURNED_HELP } else { help });
    }

    /// Whether it has the proportions of `width` and `height` swapped, and not those themselves.
    pub fn lies_across(&self, (width, height): (usize, usize)) -> bool {
        proportional(self.size, (height, width)) && !proportional(self.size, (width, height))
    }

    /// The EXIF orientation, by which programs should turn or mirror it; `None` where it is stored upright.
    pub fn orientation(&self) -> Option<Orientation> {
        let decoder = reader(&self.bytes, self.format, 0).into_decoder();
        let orientation = decoder.ok()?.orientation().ok();
        orientation.filter(|orientation| *orientation != Orientation::NoTransforms)
    }

    /// The number of [`ImageFile::orientation`], 2 to 8.
    pub fn exif_orientation(&self) -> Option<u8> {
        self.orientation().map(Orientation::to_exif)
    }

    /// Whether its EXIF orientation turns or mirrors it while its size stays the same.
    pub fn turns_without_trace(&self) -> bool {
        let (w, h) = self.size;
        // From 5 on the sides are swapped.
        self.exif_orientation()
            .is_some_and(|exif| exif < 5 || w == h)
    }

    /// The file without its EXIF orientation, by which the pixels are turned if `turns`. The rest of its EXIF stays: COLMAP starts
    /// from its focal length. Pixels that are not turned stay as they are.
    pub fn without_orientation(self, turns: bool) -> Result<Vec<u8>> {
        if self.exif_orientation().is_none() {
            return Ok(self.bytes);
        }
        self.turned(turns).map_err(|e| {
            invalid!(&self.path, "image data"; found "{e}"; expected "a photo that can be turned"; help "{DAMAGED_HELP}")
        })
    }

    fn turned(&self, turns: bool) -> ImageResult<Vec<u8>> {
        let pixels = self.size.0 as u64 * self.size.1 as u64;
        let mut decoder = reader(&self.bytes, self.format, pixels * PIXEL_BYTES).into_decoder()?;
        let mut exif = decoder.exif_metadata()?.unwrap_or_default();
        let profile = decoder.icc_profile()?;
        let find = |exif: &[u8]| {
            self.bytes
                .windows(exif.len().max(1))
                .position(|w| w == exif)
        };
        let place = find(&exif);
        let orientation = Orientation::remove_from_exif_chunk(&mut exif);
        if !turns
            && self.format == ImageFormat::Jpeg
            && let Some(place) = place
        {
            let mut bytes = self.bytes.clone();
            bytes[place..place + exif.len()].copy_from_slice(&exif);
            return Ok(bytes);
        }
        let mut image = DynamicImage::from_decoder(decoder)?;
        if let Some(orientation) = orientation.filter(|_| turns) {
            image.apply_orientation(orientation);
        }
        let mut bytes = Vec::new();
        if self.format == ImageFormat::Png {
            encode(PngEncoder::new(&mut bytes), &image, exif, profile)?;
        } else {
            let encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
            encode(encoder, &image, exif, profile)?;
        }
        Ok(bytes)
    }

    /// Bits a sample and colour type of a PNG's header (0 grey, 2 RGB, 3 palette, 4 grey + alpha, 6 RGBA).
    pub fn png_color(&self) -> Option<(u8, u8)> {
        (self.format == ImageFormat::Png)
            .then(|| self.bytes.get(24).copied().zip(self.bytes.get(25).copied()))?
    }

    pub fn decode(&self) -> Result<DynamicImage> {
        let pixels = self.size.0 as u64 * self.size.1 as u64;
        let reader = reader(&self.bytes, self.format, pixels * PIXEL_BYTES);
        reader.decode().map_err(|e| {
            invalid!(&self.path, "image data"; found "{e}"; expected "a valid {}", name(self.format); help "{DAMAGED_HELP}")
        })
    }

    /// The picture as 8-bit sRGB; transparent pixels are blended onto black.
    pub fn decode_rgb(&self) -> Result<RgbImage> {
        Ok(self.decode_photo([0; 3])?.0)
    }

    /// The photo as 8-bit sRGB, transparent pixels blended onto `background`, and whether there are any.
    pub fn decode_photo(&self, background: [u8; 3]) -> Result<(RgbImage, bool)> {
        let image = self.decode()?;
        if !image.color().has_alpha() {
            return Ok((image.into_rgb8(), false));
        }
        let rgba = image.into_rgba8();
        let transparent = rgba.pixels().any(|pixel| pixel.0[3] < u8::MAX);
        let photo = RgbImage::from_fn(rgba.width(), rgba.height(), |x, y| {
            let [color @ .., a] = rgba.get_pixel(x, y).0.map(u32::from);
            Rgb(std::array::from_fn(|i| {
                ((color[i] * a + u32::from(background[i]) * (255 - a) + 127) / 255) as u8
            }))
        });
        Ok((photo, transparent))
    }
}

fn encode(
    mut encoder: impl ImageEncoder,
    image: &DynamicImage,
    exif: Vec<u8>,
    profile: Option<Vec<u8>>,
) -> ImageResult<()> {
    encoder
        .set_exif_metadata(exif)
        .map_err(ImageError::Unsupported)?;
    if let Some(profile) = profile {
        encoder
            .set_icc_profile(profile)
            .map_err(ImageError::Unsupported)?;
    }
    image.write_with_encoder(encoder)
}

/// A decoder that allocates no more than `pixel_bytes` and [`EXTRA_BYTES`]: a colour profile may be compressed from gigabytes.
fn reader(bytes: &[u8], format: ImageFormat, pixel_bytes: u64) -> ImageReader<Cursor<&[u8]>> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(pixel_bytes + EXTRA_BYTES);
    reader.limits(limits);
    reader
}

/// Whether two sizes have the same proportions, within [`MAX_PROPORTION_ERROR`].
pub(crate) fn proportional((w, h): (usize, usize), (width, height): (usize, usize)) -> bool {
    let ratio = (w as f64 / h as f64) / (width as f64 / height as f64);
    (ratio - 1.0).abs() < MAX_PROPORTION_ERROR
}

fn name(format: ImageFormat) -> &'static str {
    if format == ImageFormat::Png {
        "PNG"
    } else {
        "JPEG"
    }
}

/// Whether the chunks of a PNG lead to its end chunk.
fn png_is_complete(bytes: &[u8]) -> bool {
    let mut rest = bytes.get(8..).unwrap_or_default();
    while let [a, b, c, d, kind @ ..] = rest {
        // Length, type, data, checksum.
        let end = (u32::from_be_bytes([*a, *b, *c, *d]) as usize).saturating_add(12);
        if end > rest.len() {
            return false;
        }
        if kind.starts_with(b"IEND") {
            return true;
        }
        rest = &rest[end..];
    }
    false
}

/// Whether the segments and scans of a JPEG lead to its end marker. (A cut-off file decodes to grey rows at its end, which the
/// decoder accepts. An embedded thumbnail has an end marker of its own, so a search for one is not enough.)
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    const END: u8 = 0xD9;
    const SCAN: u8 = 0xDA;
    let standalone = |m: u8| m == 0x01 || (0xD0..=0xD8).contains(&m);
    let mut at = 2;
    while let (Some(0xFF), Some(&marker)) = (bytes.get(at), bytes.get(at + 1)) {
        match marker {
            END => return true,
            0xFF => at += 1,
            m if standalone(m) => at += 2,
            _ => {
                let (Some(&high), Some(&low)) = (bytes.get(at + 2), bytes.get(at + 3)) else {
                    return false;
                };
                at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2);
                if marker == SCAN {
                    // Entropy-coded data: up to the next marker that is neither a stuffed byte nor a restart.
                    let Some(data) = bytes.get(at..) else {
                        return false;
                    };
                    let next = data
                        .windows(2)
                        .position(|w| w[0] == 0xFF && w[1] != 0 && !standalone(w[1]));
                    let Some(next) = next else { return false };
                    at += next;
                }
            }
        }
    }
    false
}
