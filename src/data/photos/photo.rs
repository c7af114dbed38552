//! The photo of a view: a file that is decoded when its pixels are asked for, or pixels made in memory.

use super::image_file::ImageFile;
use super::lens::Undistortion;
use crate::error::{Result, ensure};
use image::RgbImage;
use image::imageops::{FilterType, resize};
use sha2::{Digest, Sha256};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// The photo of a view, 8-bit sRGB.
///
/// Photos of a scene folder stay in their files, which must not change while the scene is in use. [`Photo::pixels`] returns them
/// from memory, where [`LoadOptions::decoded_mb`](crate::data::LoadOptions::decoded_mb) had room for them, or decodes them and
/// removes the distortion of the lens. The pixels are the same ones each time.
/// Photos made in memory stay there.
#[derive(Clone)]
pub struct Photo {
    width: usize,
    height: usize,
    transparent: bool,
    source: Source,
}

#[derive(Clone)]
enum Source {
    Pixels(Arc<RgbImage>),
    File(Arc<PhotoFile>),
}

/// A photo that lies in a file.
struct PhotoFile {
    path: PathBuf,
    /// SHA-256 of the file when the scene was loaded.
    digest: [u8; 32],
    preprocessing: Preprocessing,
    /// The pixels, where there was room for them.
    kept: Option<Arc<RgbImage>>,
}

impl Photo {
    /// The photo in `file`, decoded once to see that it can be. It stays in memory where its bytes fit in `room`, the bytes that
    /// photos of the scene may still take.
    pub(crate) fn in_file(
        file: &ImageFile,
        preprocessing: Preprocessing,
        room: &AtomicUsize,
    ) -> Result<Self> {
        let (pixels, transparent) = preprocessing.decode(file)?;
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        let bytes = pixels.as_raw().len();
        let kept = room.fetch_update(Relaxed, Relaxed, |room| room.checked_sub(bytes));
        let path = file.path().to_owned();
        let digest = file.digest();
        let file = PhotoFile {
            path,
            digest,
            preprocessing,
            kept: kept.is_ok().then(|| Arc::new(pixels)),
        };
        Ok(Self {
            width,
            height,
            transparent,
            source: Source::File(Arc::new(file)),
        })
    }

    /// The file that it lies in.
    pub fn file(&self) -> Option<&Path> {
        match &self.source {
            Source::Pixels(_) => None,
            Source::File(file) => Some(&file.path),
        }
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether the file has transparent pixels, which are blended onto [`crate::data::LoadOptions::background`].
    pub fn is_transparent(&self) -> bool {
        self.transparent
    }

    /// The pixels. They stay in memory as long as the caller or the scene holds them.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file can no longer be read, [`crate::Error::Input`] when it has changed since the
    /// scene was loaded.
    pub fn pixels(&self) -> Result<Arc<RgbImage>> {
        match &self.source {
            Source::Pixels(pixels) => Ok(pixels.clone()),
            Source::File(file) => match &file.kept {
                Some(pixels) => Ok(pixels.clone()),
                None => Ok(Arc::new(file.read()?)),
            },
        }
    }

    /// Adds to `hash` what determines the pixels, without decoding them: the file as it was when the scene was loaded, and how its
    /// pixels are processed. Photos that lie in no file add their pixels.
    pub(crate) fn identify(&self, hash: &mut Sha256) {
        match &self.source {
            Source::Pixels(pixels) => {
                hash.update(b"pixels\n");
                hash.update(pixels.as_raw());
            }
            Source::File(file) => {
                hash.update(format!("file {} {}\n", self.width, self.height));
                hash.update(file.digest);
                if self.transparent {
                    hash.update(file.preprocessing.background);
                }
                let undistortion = file.preprocessing.undistortion.iter();
                let numbers = undistortion.flat_map(Undistortion::numbers);
                numbers.for_each(|number| hash.update(number.to_le_bytes()));
            }
        }
    }
}

impl From<RgbImage> for Photo {
    fn from(pixels: RgbImage) -> Self {
        let (width, height) = (pixels.width() as usize, pixels.height() as usize);
        Self {
            width,
            height,
            transparent: false,
            source: Source::Pixels(Arc::new(pixels)),
        }
    }
}

impl fmt::Debug for Photo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = f.debug_struct("Photo");
        text.field("width", &self.width)
            .field("height", &self.height);
        if let Source::File(file) = &self.source {
            text.field("path", &file.path);
        }
        text.finish()
    }
}

impl PhotoFile {
    fn read(&self) -> Result<RgbImage> {
        let file = ImageFile::open(&self.path)?;
        ensure!(file.digest() == self.digest, &self.path, "content"; found "other bytes";
            expected "the file that the scene was loaded with";
            help "put it back and resume, or start anew with the files as they are");
        Ok(self.preprocessing.decode(&file)?.0)
    }
}

/// What becomes of a file's pixels: the distortion of the lens is taken out, then they are resampled.
#[derive(Clone, Default)]
pub(crate) struct Preprocessing {
    /// The distortion; none of a pinhole.
    pub undistortion: Option<Undistortion>,
    /// Pixels across and down, where they are fewer than the file's.
    pub size: Option<(usize, usize)>,
    /// What transparent pixels are blended onto.
    pub background: [u8; 3],
}

impl Preprocessing {
    /// The photo in `file` as the view's camera sees it, and whether some pixel is transparent.
    pub fn decode(&self, file: &ImageFile) -> Result<(RgbImage, bool)> {
        let (mut photo, transparent) = file.decode_photo(self.background)?;
        if let Some(undistortion) = &self.undistortion {
            photo = undistortion.photo(&photo);
        }
        if let Some((width, height)) = self.size {
            // Bicubic, the kernel as wide as the reduction: what 3DGS does with photos of more than 1600 pixels.
            let (width, height) = (width as u32, height as u32);
            photo = resize(&photo, width, height, FilterType::CatmullRom);
        }
        Ok((photo, transparent))
    }
}
