//! Radii of the Gaussians of one view.

use crate::backend::device::read;
use crate::error::Result;
use burn::tensor::{Device, Tensor, TensorData};
use std::sync::Arc;

/// Radius in pixels of every Gaussian, `[N]`; 0 = not visible. On a GPU they stay there until they are read.
#[derive(Clone, Debug)]
pub struct Radii(Place);

#[derive(Clone, Debug)]
enum Place {
    Host(Arc<Vec<u32>>),
    Device(Box<Tensor<1>>),
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

    pub(super) fn on_device(radii: Tensor<1>) -> Self {
        Self(Place::Device(Box::new(radii)))
    }

    /// The radii; from a GPU this waits for the device and copies.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when a device fails.
    pub fn read(&self) -> Result<Arc<Vec<u32>>> {
        match &self.0 {
            Place::Host(radii) => Ok(radii.clone()),
            Place::Device(radii) => {
                let radii = read("radii", (**radii).clone())?;
                Ok(Arc::new(
                    radii.into_iter().map(|radius| radius as u32).collect(),
                ))
            }
        }
    }

    /// The radii on `device`, without autodiff, as floats.
    pub fn as_tensor(&self, device: &Device) -> Tensor<1> {
        match &self.0 {
            Place::Host(radii) => {
                let values: Vec<f32> = radii.iter().map(|&radius| radius as f32).collect();
                Tensor::from_data(
                    TensorData::new(values, [radii.len()]),
                    &device.clone().inner(),
                )
            }
            Place::Device(radii) => (**radii).clone(),
        }
    }
}
