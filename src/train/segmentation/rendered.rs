//! Blending on a GPU, where weights are not stored: a view is rendered anew at each use, with the values as channels.

use crate::camera::Camera;
use crate::device::read;
use crate::error::Result;
use crate::ops::Blending;
use crate::raster::{Settings, SplatTensors};
use burn::tensor::{Tensor, TensorData};

/// What is left of the background at every pixel, and the Gaussians of `splats` that some pixel shows for which `wanted` says so
/// from its number and transmittance.
pub(super) fn visible(
    splats: &SplatTensors,
    camera: &Camera,
    settings: &Settings,
    wanted: impl Fn(usize, f32) -> bool,
) -> Result<(Vec<f32>, Vec<u32>)> {
    let device = splats.means.device();
    // Next to nothing is blended: the transmittance is what is asked for.
    let nothing = Tensor::<2>::zeros([splats.len(), 1], &device);
    let transmittance = read("transmittance", splats.blend(nothing, camera, settings)?.transmittance)?;
    let mask = transmittance.iter().enumerate().map(|(pixel, &t)| f32::from(u8::from(wanted(pixel, t)))).collect();
    let mask = TensorData::new::<f32, _>(mask, [camera.height, camera.width, 1]);
    let weights = read("weights", splats.adjoint(Tensor::from_data(mask, &device), camera, settings)?.sums)?;
    let visible = weights.iter().zip(0..).filter(|(weight, _)| **weight > 0.0).map(|(_, i)| i).collect();
    Ok((transmittance, visible))
}

/// A view of the Gaussians that it shows.
#[derive(Clone, Debug)]
pub(super) struct RenderedView {
    pub splats: SplatTensors,
    pub camera: Camera,
    pub settings: Settings,
}

impl Blending for RenderedView {
    fn blend(&self, values: Tensor<2>, pixels: &[u32]) -> Result<Tensor<2>> {
        let (image, transmittance) = self.splats.blend_at(values, &self.camera, &self.settings, pixels)?;
        let coverage = transmittance.neg() + 1.0;
        Ok(image / coverage.reshape([pixels.len(), 1]))
    }
}
