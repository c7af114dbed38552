//! The training photos as targets of the loss, made at first use and kept while memory allows.

use crate::backend::device::in_host_memory;
use crate::data::View;
use crate::error::Result;
use crate::ops::PhotometricTarget;
use burn::tensor::Device;
use std::sync::Arc;

/// Bytes of targets that are kept for a CPU. The target of a view beyond it is made again at each use.
const CPU_BUDGET: usize = 1 << 30;
/// Bytes of targets that are kept for a GPU: 345 photos of 1920x1080 pixels.
const GPU_BUDGET: usize = 2 << 30;

/// Targets by index of the training view.
#[derive(Debug)]
pub(crate) struct Targets {
    kept: Vec<Option<Arc<PhotometricTarget>>>,
    bytes: usize,
    on_cpu: bool,
}

impl Targets {
    /// No target yet of `views` views, which are rendered on `device`.
    pub fn new(views: usize, device: &Device) -> Self {
        Self {
            kept: vec![None; views],
            bytes: 0,
            on_cpu: in_host_memory(device),
        }
    }

    /// The target of `view`, whose index is `index`.
    ///
    /// # Errors
    /// Those of [`crate::data::Photo::pixels`].
    pub fn get(&mut self, index: usize, view: &View) -> Result<Arc<PhotometricTarget>> {
        if let Some(Some(target)) = self.kept.get(index) {
            return Ok(target.clone());
        }
        let target = PhotometricTarget::new(view.image.pixels()?, view.mask.clone());
        let target = Arc::new(target);
        let pixels = view.image.width() * view.image.height();
        let (bytes, budget) = if self.on_cpu {
            (PhotometricTarget::bytes_on_cpu(pixels), CPU_BUDGET)
        } else {
            (PhotometricTarget::bytes_on_gpu(pixels), GPU_BUDGET)
        };
        if let Some(slot) = self.kept.get_mut(index)
            && self.bytes + bytes <= budget
        {
            *slot = Some(target.clone());
            self.bytes += bytes;
        }
        Ok(target)
    }
}
