//! What a rendered image is compared with: a photo prepared on the host, or its bytes, which a GPU prepares.

use super::Photo;
#[cfg(feature = "cube")]
use super::gpu::DeviceBytes;
use super::photo::CHANNELS;
#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
use crate::data::mask::Mask;
use image::RgbImage;
use std::sync::Arc;

/// A photo of 8 bits a channel, whose values are v / 255. A GPU keeps the bytes, and makes the windowed moments anew in each
/// comparison: a twelfth of the memory of a [`Photo`]. The host prepares a [`Photo`] each time.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedPhoto {
    pixels: Arc<RgbImage>,
    /// Pixels that are left out are black.
    pub(super) mask: Option<Mask>,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<DeviceBytes>,
}

impl PackedPhoto {
    /// Of these pixels.
    pub fn new(pixels: Arc<RgbImage>) -> Self {
        Self {
            pixels,
            mask: None,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
        }
    }

    /// As [`PackedPhoto::new`], and what `mask` leaves out counts for nothing, as in [`Photo::masked`].
    ///
    /// # Panics
    /// If the mask has another size.
    pub fn masked(pixels: &RgbImage, mask: Mask) -> Self {
        let mut pixels = pixels.clone();
        let size = (pixels.width() as usize, pixels.height() as usize);
        assert_eq!(
            (mask.width(), mask.height()),
            size,
            "photo: mask against pixels"
        );
        mask.fill(&mut pixels, CHANNELS, 0);
        Self {
            mask: Some(mask),
            ..Self::new(Arc::new(pixels))
        }
    }

    /// (height, width) in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.pixels.height() as usize, self.pixels.width() as usize)
    }

    /// Bytes held by a photo of this size in host memory; a GPU that it is compared on holds as many.
    pub fn bytes(height: usize, width: usize) -> usize {
        (height * width * 3).next_multiple_of(4)
    }

    /// The same photo, prepared on the host.
    pub fn prepared(&self) -> Photo {
        let (height, width) = self.size();
        let rgb = self
            .pixels
            .as_raw()
            .iter()
            .map(|&v| f32::from(v) / 255.0)
            .collect();
        match &self.mask {
            Some(mask) => Photo::masked(rgb, height, width, mask.clone()),
            None => Photo::new(rgb, height, width),
        }
    }

    /// `[H, W, 3]` values row by row, four to a word, the first one lowest; the last word is filled up with zeros.
    #[cfg(feature = "cube")]
    pub(super) fn words(&self) -> Vec<u32> {
        let (words, rest) = self.pixels.as_raw().as_chunks::<4>();
        let mut packed: Vec<u32> = words.iter().map(|&word| u32::from_le_bytes(word)).collect();
        if !rest.is_empty() {
            let mut last = [0; 4];
            last[..rest.len()].copy_from_slice(rest);
            packed.push(u32::from_le_bytes(last));
        }
        packed
    }
}

/// What a rendered image is compared with.
#[derive(Clone, Debug, PartialEq)]
pub enum Compared {
    /// A photo with its windowed moments.
    Prepared(Arc<Photo>),
    /// The bytes of one.
    Packed(Arc<PackedPhoto>),
}

impl Compared {
    /// (height, width) in pixels.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Prepared(photo) => photo.size(),
            Self::Packed(photo) => photo.size(),
        }
    }

    /// Prepared on the host.
    pub(super) fn prepared(&self) -> Arc<Photo> {
        match self {
            Self::Prepared(photo) => photo.clone(),
            Self::Packed(photo) => Arc::new(photo.prepared()),
        }
    }
}

impl From<Arc<Photo>> for Compared {
    fn from(photo: Arc<Photo>) -> Self {
        Self::Prepared(photo)
    }
}

impl From<Arc<PackedPhoto>> for Compared {
    fn from(photo: Arc<PackedPhoto>) -> Self {
        Self::Packed(photo)
    }
}
