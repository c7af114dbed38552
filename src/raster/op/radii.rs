//! Radii of the Gaussians of one view.

use crate::error::Result;
#[cfg(feature = "wgpu")]
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// Radius in pixels of every Gaussian, `[N]`; 0 = not visible. On a GPU they stay there until they are read.
#[derive(Clone, Debug)]
pub struct Radii(Place);

#[derive(Clone, Debug)]
enum Place {
    Host(Arc<Vec<u32>>),
    #[cfg(feature = "wgpu")]
    Device(Box<CubeTensor>),
}

impl Default for Radii {
    fn default() -> Self {
        Self::on_host(Vec::new())
    }
}

impl Radii {
    pub(super) fn on_host(radii: Vec<u32>) -> Self {
        Self(Place::Host(Arc::new(radii)))
    }

    #[cfg(feature = "wgpu")]
    pub(super) fn on_device(radii: CubeTensor) -> Self {
        Self(Place::Device(Box::new(radii)))
    }

    /// The radii; from a GPU this waits for the device and copies.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when a device fails.
    pub fn read(&self) -> Result<Arc<Vec<u32>>> {
        match &self.0 {
            Place::Host(radii) => Ok(radii.clone()),
            #[cfg(feature = "wgpu")]
            Place::Device(radii) => crate::raster::gpu::read_radii(radii).map(Arc::new),
        }
    }
}
