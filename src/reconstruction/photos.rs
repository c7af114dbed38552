//! The training photos as the loss takes them, made at first use and kept while memory allows.

use crate::backend::device::in_host_memory;
use crate::data::View;
use crate::error::Result;
use crate::ops::{Compared, PackedPhoto, Photo};
use burn::tensor::Device;
use std::sync::Arc;

/// Bytes of photos with their SSIM moments that are kept in host memory; views beyond it are converted again at each use.
const HOST_BUDGET: usize = 1 << 30;
/// Bytes of photos that are kept on a GPU, and in host memory besides: 345 of 1920x1080 pixels.
const DEVICE_BUDGET: usize = 2 << 30;

/// Photos by index of the training view.
#[derive(Debug)]
pub(crate) struct Photos {
    kept: Vec<Option<Compared>>,
    bytes: usize,
    on_host: bool,
}

impl Photos {
    /// None yet of `views` views, which are rendered on `device`.
    pub fn new(views: usize, device: &Device) -> Self {
        Self {
            kept: vec![None; views],
            bytes: 0,
            on_host: in_host_memory(device),
        }
    }

    /// The photo of `view`, which is number `index`.
    ///
    /// # Errors
    /// Its file can no longer be read.
    pub fn get(&mut self, index: usize, view: &View) -> Result<Compared> {
        if let Some(Some(photo)) = self.kept.get(index) {
            return Ok(photo.clone());
        }
        let (width, height) = (view.image.width(), view.image.height());
        let (photo, bytes, budget) = if self.on_host {
            let photo = match view.mask.clone() {
                Some(mask) => Photo::masked(view.rgb()?, height, width, mask),
                None => Photo::new(view.rgb()?, height, width),
            };
            (
                Compared::Prepared(Arc::new(photo)),
                Photo::<f32>::bytes(height, width),
                HOST_BUDGET,
            )
        } else {
            let photo = match view.mask.clone() {
                Some(mask) => PackedPhoto::masked(&*view.image.pixels()?, mask),
                None => PackedPhoto::new(view.image.pixels()?),
            };
            (
                Compared::Packed(Arc::new(photo)),
                PackedPhoto::bytes(height, width),
                DEVICE_BUDGET,
            )
        };
        if let Some(slot) = self.kept.get_mut(index)
            && self.bytes + bytes <= budget
        {
            *slot = Some(photo.clone());
            self.bytes += bytes;
        }
        Ok(photo)
    }
}
