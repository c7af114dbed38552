//! What a rendered image is compared with: a photo prepared on the host, or its bytes, which a GPU prepares.

use super::Photo;
#[cfg(feature = "cube")]
use crate::gpu::Resident;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;
use image::RgbImage;
use std::sync::Arc;

/// A photo of 8 bits a channel, whose values are v / 255. A GPU keeps the bytes, and makes the windowed moments anew in each
/// comparison: a twelfth of the memory of a [`Photo`]. The host prepares a [`Photo`] each time.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedPhoto {
    pixels: Arc<RgbImage>,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<CubeTensor>,
}

impl PackedPhoto {
    /// Of these pixels.
    pub fn new(pixels: Arc<RgbImage>) -> Self {
        Self {
            pixels,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
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
        Photo::new(self.pixels.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect(), height, width)
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
