//! The forward and the backward pass.

use super::blend;
use super::inputs::Inputs;
use super::parameters::{self, GeometryGradients};
use super::pixel_sums::{PixelGradients, pixel_sums, row_bytes};
use super::prepare::{Prepared, check_size};
use super::sh::Harmonics;
use crate::backend::gpu::Gpu;
use crate::error::Result;
use crate::raster::settings::Settings;
use crate::splat::camera::Camera;
use burn::backend::ops::FloatTensorOps;
use burn::tensor::Slice;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;

/// What the forward pass leaves for the backward pass.
pub(crate) struct Forward {
    prepared: Prepared,
    /// What was blended, `[N, C]`, colours first.
    values: CubeTensor,
    /// `[H, W]`.
    pub transmittance: CubeTensor,
}

/// Gradients of the inputs.
pub(crate) struct Gradients {
    pub geometry: GeometryGradients,
    pub sh: Option<CubeTensor>,
    pub features: Option<CubeTensor>,
}

/// Renders `inputs`, at least one Gaussian and one channel: the image `[H, W, C]`, or `None` when an input holds a NaN or an
/// infinity.
///
/// # Errors
/// [`crate::Error::Config`] for settings out of range; [`crate::Error::Argument`] for an unusable camera; [`crate::Error::Limit`] for
/// what the device cannot hold; [`crate::Error::Device`] when it fails.
pub(in crate::raster) fn forward(
    inputs: &Inputs,
    camera: &Camera,
    settings: &Settings,
    background: [f64; 3],
) -> Result<Option<(CubeTensor, Forward)>> {
    let gpu = Gpu::of(&inputs.means);
    let channels = inputs.channels();
    let pixels = camera.width.saturating_mul(camera.height);
    check_size(
        &gpu,
        "pixels times channels",
        pixels.saturating_mul(channels.max(1)),
        size_of::<f32>(),
    )?;
    for tensor in inputs.coefficients_and_features() {
        check_size(
            &gpu,
            "values of the Gaussians",
            tensor.meta.num_elements(),
            size_of::<f32>(),
        )?;
    }
    let Some(prepared) = Prepared::new(inputs, camera, settings, background)? else {
        return Ok(None);
    };
    let radii = &prepared.projected.radii;
    let colours = |sh: &Harmonics| sh.colours(&inputs.means, radii, &prepared.view);
    let colours = inputs.sh.as_ref().map(colours);
    let values = inputs.values(colours);
    let (image, transmittance) = blend::blend(&gpu, &prepared, &values, channels);
    Ok(Some((
        image,
        Forward {
            prepared,
            values,
            transmittance,
        },
    )))
}

impl Forward {
    /// Radii in pixels, `[N]`, `u32`; 0 = culled.
    pub fn radii(&self) -> CubeTensor {
        self.prepared.projected.radii.clone()
    }

    /// Gradients of all inputs. `image` is the output of [`forward`]; `d_image` (`[H, W, C]`) and `d_transmittance` (`[H, W]`) are
    /// contiguous. `absolute` adds sums of absolute screen-space gradients, for at most [`super::ABSOLUTE_CHANNELS`] channels.
    pub fn backward(
        &self,
        inputs: &Inputs,
        image: &CubeTensor,
        d_image: &CubeTensor,
        d_transmittance: &CubeTensor,
        absolute: bool,
    ) -> Gradients {
        let gpu = Gpu::of(&inputs.means);
        let view = &self.prepared.view;
        let projected = &self.prepared.projected;
        let pixels = PixelGradients {
            image,
            d_image,
            transmittance: &self.transmittance,
            d_transmittance: Some(d_transmittance),
            absolute,
        };
        let values = Some(&self.values);
        let sums = pixel_sums(&gpu, &self.prepared, values, &pixels, row_bytes(&gpu));
        let geometry = parameters::backward(&gpu, inputs, view, projected, &sums.moments);
        let features = inputs.features.as_ref().map(|_| match &inputs.sh {
            None => sums.values.clone(),
            Some(_) => {
                let after_colours = [Slice::full(), Slice::from(3..)];
                CubeBackend::float_slice(sums.values.clone(), &after_colours)
            }
        });
        let sh = inputs.sh.as_ref().map(|sh| {
            sh.backward(
                &inputs.means,
                &projected.radii,
                view,
                &self.values,
                &sums.values,
                &geometry.means,
            )
        });
        Gradients {
            geometry,
            sh,
            features,
        }
    }
}
