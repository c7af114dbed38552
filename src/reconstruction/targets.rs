//! The training photos as targets of the loss, made at first use and kept while memory allows.

use crate::data::View;
use crate::error::Result;
use crate::ops::PhotometricTarget;
use burn::tensor::Device;
use std::sync::Arc;

/// Targets by index of the training view.
#[derive(Debug)]
pub(crate) struct Targets {
    kept: Vec<Option<Arc<PhotometricTarget>>>,
    bytes: usize,
    device: Device,
}

impl Targets {
    /// No target yet of `views` views, which are rendered on `device`.
    pub fn new(views: usize, device: &Device) -> Self {
        Self {
            kept: vec![None; views],
            bytes: 0,
            device: device.clone(),
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
        let bytes = PhotometricTarget::bytes(pixels, &self.device);
        let budget = PhotometricTarget::budget(&self.device);
        if let Some(slot) = self.kept.get_mut(index)
            && self.bytes + bytes <= budget
        {
            *slot = Some(target.clone());
            self.bytes += bytes;
        }
        Ok(target)
    }
}
