//! The training photos with their SSIM moments, made at first use and kept while memory allows.

use crate::data::View;
use crate::error::Result;
use crate::ops::Photo;
use std::sync::Arc;

/// Bytes of photos that are kept; views beyond it are converted again at each use.
const BUDGET: usize = 1 << 30;

/// Photos by index of the training view.
#[derive(Debug)]
pub(super) struct Photos {
    kept: Vec<Option<Arc<Photo>>>,
    bytes: usize,
}

impl Photos {
    pub fn new(views: usize) -> Self {
        Self { kept: vec![None; views], bytes: 0 }
    }

    /// The photo of `view`, which is number `index`.
    ///
    /// # Errors
    /// Its file can no longer be read.
    pub fn get(&mut self, index: usize, view: &View) -> Result<Arc<Photo>> {
        if let Some(Some(photo)) = self.kept.get(index) {
            return Ok(photo.clone());
        }
        let (width, height) = (view.image.width(), view.image.height());
        let photo = Arc::new(Photo::new(view.rgb()?, height, width));
        let bytes = Photo::<f32>::bytes(height, width);
        if let Some(slot) = self.kept.get_mut(index)
            && self.bytes + bytes <= BUDGET
        {
            *slot = Some(photo.clone());
            self.bytes += bytes;
        }
        Ok(photo)
    }
}
