//! Blending on a GPU, where weights are not stored: a view is rendered anew at each use, with the values as channels.

use crate::backend::device::read;
use crate::error::Result;
use crate::raster::SplatView;
use crate::segmentation::pixels::Blending;
use burn::tensor::{Tensor, TensorData};

/// What is left of the background at every pixel of `view`, and the Gaussians that some pixel shows for which `wanted` says so
/// from its number and transmittance.
pub(crate) fn visible(
    view: &SplatView,
    wanted: impl Fn(usize, f32) -> bool,
) -> Result<(Vec<f32>, Vec<u32>)> {
    let (camera, device) = (view.camera(), view.splats().means.device());
    // Next to nothing is blended: the transmittance is what is asked for.
    let nothing = Tensor::<2>::zeros([view.splats().len(), 1], &device);
    let transmittance = read("transmittance", view.blend(nothing)?.1)?;
    let mask = transmittance
        .iter()
        .enumerate()
        .map(|(pixel, &t)| f32::from(u8::from(wanted(pixel, t))))
        .collect();
    let mask = TensorData::new::<f32, _>(mask, [camera.height, camera.width, 1]);
    let weights = read(
        "weights",
        view.blend_adjoint(Tensor::from_data(mask, &device))?.sums,
    )?;
    let visible = weights
        .iter()
        .zip(0..)
        .filter(|(weight, _)| **weight > 0.0)
        .map(|(_, i)| i)
        .collect();
    Ok((transmittance, visible))
}

/// A view of the Gaussians that it shows.
#[derive(Clone, Debug)]
pub(crate) struct RenderedView(pub SplatView);

impl RenderedView {
    /// Bytes that a view of so many Gaussians takes: geometry, projection, and lists of some eight tiles each.
    pub fn bytes(gaussians: usize) -> usize {
        160 * gaussians
    }
}

impl Blending for RenderedView {
    fn blend(&self, values: Tensor<2>, pixels: &[u32]) -> Result<Tensor<2>> {
        let (image, transmittance) = self.0.blend_at(values, pixels)?;
        let coverage = transmittance.neg() + 1.0;
        Ok(image / coverage.reshape([pixels.len(), 1]))
    }
}
