//! Labels of pixels, that a device takes up once.

use super::label_loss::UNLABELLED;
#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;
use std::ops::Deref;

/// Class index of each of some pixels, [`UNLABELLED`] where it is not counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelLabels {
    // Not to be changed: a device may hold a copy.
    ids: Vec<u16>,
    counted: usize,
    end: usize,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<CubeTensor>,
}

impl PixelLabels {
    /// How many are counted.
    pub fn counted(&self) -> usize {
        self.counted
    }

    /// One more than the largest class index, 0 where no pixel is counted.
    pub fn end(&self) -> usize {
        self.end
    }
}

impl From<Vec<u16>> for PixelLabels {
    fn from(ids: Vec<u16>) -> Self {
        let known = || ids.iter().filter(|&&id| id != UNLABELLED);
        Self {
            counted: known().count(),
            end: known().max().map_or(0, |&id| usize::from(id) + 1),
            ids,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
        }
    }
}

impl Deref for PixelLabels {
    type Target = [u16];
    fn deref(&self) -> &[u16] {
        &self.ids
    }
}
