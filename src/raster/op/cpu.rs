//! The operations by the CPU's kernels: slices from tensors, tensors from slices.

use super::tensors::{
    BlendedView, Forward, INPUTS, OfHost, PixelTensors, ProjectedView, RasterCall, RasterPass,
    RasterTensors, Rows, SavedForward, ViewCall,
};
use crate::backend::{HostBackend, HostValues, Real, check_finite, device_of, real_kernel};
use crate::error::{Error, Result, invalid};
use crate::raster::PixelGradients;
use crate::raster::cpu::projected::{Blended, Projected};
use crate::raster::cpu::sh::Harmonics;
use crate::raster::settings::Splats;
use burn::backend::{TensorMetadata, tensor::FloatTensor};
use std::sync::Arc;

pub(super) fn raster_forward<B: HostBackend>(
    tensors: RasterTensors<B>,
    call: Arc<RasterCall>,
) -> RasterPass<B> {
    let device = device_of::<B>(&tensors.means);
    let channels = call.colours() + tensors.features.shape()[1];
    real_kernel!(tensors.means, E => {
        let (image, forward) = match Inputs::<E>::read::<B>(tensors).forward(&call) {
            Ok(found) => found,
            Err(error) => return RasterPass::Failed(error),
        };
        let [w, h] = forward.projected.size();
        let radii: Vec<E> = forward.projected.radii().iter().map(|&r| E::of(f64::from(r))).collect();
        RasterPass::Done {
            image: B::tensor::<E>(image, &[h, w, channels], &device),
            transmittance: B::tensor::<E>(forward.transmittance.clone(), &[h, w], &device),
            radii: B::tensor::<E>(radii, &[forward.projected.len()], &device),
            saved: forward.into(),
        }
    })
}

pub(super) fn raster_backward<B: HostBackend>(
    tensors: RasterTensors<B>,
    pixels: PixelTensors<B>,
    saved: SavedForward,
    call: Arc<RasterCall>,
) -> RasterTensors<B> {
    let device = device_of::<B>(&pixels.image);
    let tensors = tensors.into_array();
    let shapes = tensors.each_ref().map(|t| t.shape());
    real_kernel!(pixels.image, E => {
        let inputs = Inputs::<E>::read::<B>(RasterTensors::from_array(tensors));
        let [image, d_image, d_transmittance] =
            [pixels.image, pixels.d_image, pixels.d_transmittance].map(B::values::<E>);
        let Some(forward) = OfHost::<Forward<E>>::of_host(&saved) else {
            unreachable!("another precision or device saved the forward pass");
        };
        let pixels = PixelGradients {
            image: &image,
            transmittance: &forward.transmittance,
            d_image: &d_image,
            d_transmittance: Some(&d_transmittance),
        };
        let gradients = inputs.backward(&call, forward, pixels);
        let mut shapes = shapes.iter();
        RasterTensors::from_array(gradients.map(|values| {
            let shape = shapes.next().map_or_else(Vec::new, |shape| shape.to_vec());
            // An absent screen tensor has no gradient, but the kernel computes one.
            let shape = if shape.iter().product::<usize>() == values.len() { shape } else { vec![values.len()] };
            B::tensor::<E>(values, &shape, &device)
        }))
    })
}

pub(super) fn project_view<B: HostBackend>(
    tensors: RasterTensors<B>,
    call: Arc<ViewCall>,
) -> Result<ProjectedView> {
    real_kernel!(tensors.means, E => {
        let inputs = Inputs::<E>::read::<B>(tensors);
        Ok(Projected::new(&inputs.splats(), &call.camera, &call.settings)?.into())
    })
}

pub(super) fn view_colours<B: HostBackend>(
    means: FloatTensor<B>,
    sh: FloatTensor<B>,
    degree: usize,
    view: ProjectedView,
    call: Arc<ViewCall>,
) -> Rows<B> {
    let device = device_of::<B>(&means);
    let shape = means.shape();
    real_kernel!(means, E => {
        let Some(projected) = OfHost::<Projected<E>>::of_host(&view) else {
            return Rows::Failed(other_kernels());
        };
        let stored = sh.shape()[1].isqrt() - 1;
        let means = B::values::<E>(means);
        let sh = B::values::<E>(sh);
        let harmonics = Harmonics::new(&means, &sh, stored, degree, &call.camera);
        match harmonics.colours(projected.radii()) {
            Ok(colours) => Rows::Done(B::tensor::<E>(colours, &shape, &device)),
            Err(error) => Rows::Failed(error),
        }
    })
}

/// The error for a view that was projected on a different device than `tensors` live on, or in another precision.
pub(super) fn other_kernels() -> Error {
    invalid!(argument "tensors of a view"; found "a different device or float type than the Gaussians have";
        expected "those of the Gaussians"; help "move or cast the tensors")
}

pub(super) fn blend_view<B: HostBackend>(
    values: FloatTensor<B>,
    view: ProjectedView,
) -> BlendedView<B> {
    let device = device_of::<B>(&values);
    let channels = values.shape()[1];
    real_kernel!(values, E => {
        let Some(projected) = OfHost::<Projected<E>>::of_host(&view) else {
            return BlendedView::Failed(other_kernels());
        };
        let [w, h] = projected.size();
        let Blended { image, transmittance } = projected.blend(&B::values::<E>(values), channels);
        BlendedView::Done(
            B::tensor::<E>(image, &[h, w, channels], &device),
            B::tensor::<E>(transmittance, &[h, w], &device),
        )
    })
}

pub(super) fn blend_view_adjoint<B: HostBackend>(
    image: FloatTensor<B>,
    view: ProjectedView,
) -> Rows<B> {
    let device = device_of::<B>(&image);
    let channels = image.shape()[2];
    real_kernel!(image, E => {
        let Some(projected) = OfHost::<Projected<E>>::of_host(&view) else {
            return Rows::Failed(other_kernels());
        };
        let sums = projected.blend_adjoint(&B::values::<E>(image), channels);
        Rows::Done(B::tensor::<E>(sums, &[projected.len(), channels], &device))
    })
}

/// Slices of the inputs.
struct Inputs<E> {
    means: HostValues<E>,
    log_scales: HostValues<E>,
    rotations: HostValues<E>,
    opacity_logits: HostValues<E>,
    sh: HostValues<E>,
    features: HostValues<E>,
    /// Channels of the features; without Gaussians only the shape has them.
    feature_channels: usize,
}

impl<E: Real> Inputs<E> {
    fn read<B: HostBackend>(tensors: RasterTensors<B>) -> Self {
        Self {
            feature_channels: tensors.features.shape()[1],
            means: B::values(tensors.means),
            log_scales: B::values(tensors.log_scales),
            rotations: B::values(tensors.rotations),
            opacity_logits: B::values(tensors.opacity_logits),
            sh: B::values(tensors.sh),
            features: B::values(tensors.features),
        }
    }

    fn splats(&self) -> Splats<'_, E> {
        Splats {
            means: &self.means,
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            opacity_logits: &self.opacity_logits,
        }
    }

    fn harmonics(&self, call: &RasterCall) -> Option<Harmonics<'_, E>> {
        let active = call.active_sh_degree;
        let of_degree =
            |degree| Harmonics::new(&self.means, &self.sh, degree, active, &call.camera);
        call.sh_degree.map(of_degree)
    }

    /// Image `[H, W, channels]`, background included, and what the backward pass needs.
    fn forward(&self, call: &RasterCall) -> Result<(Vec<E>, Forward<E>)> {
        check_finite("features", &self.features, self.feature_channels)?;
        let projected = Projected::new(&self.splats(), &call.camera, &call.settings)?;
        let channels = call.colours() + self.feature_channels;
        let values = self.blended_values(call, projected.radii())?;
        let Blended {
            mut image,
            transmittance,
        } = projected.blend(values.as_deref().unwrap_or(&self.features), channels);
        let background = call.background.map(E::of);
        if call.sh_degree.is_some() && background != [E::zero(); 3] {
            for (pixel, &t) in image.chunks_exact_mut(channels).zip(&transmittance) {
                for (value, &b) in pixel.iter_mut().zip(&background) {
                    *value += t * b;
                }
            }
        }
        let forward = Forward {
            projected,
            values,
            transmittance,
        };
        Ok((image, forward))
    }

    /// Colours and features side by side, `[N, C]`; `None` for the features alone.
    fn blended_values(&self, call: &RasterCall, radii: &[u32]) -> Result<Option<Vec<E>>> {
        let Some(harmonics) = self.harmonics(call) else {
            return Ok(None);
        };
        let colours = harmonics.colours(radii)?;
        if self.feature_channels == 0 {
            return Ok(Some(colours));
        }
        let rows = colours
            .chunks_exact(3)
            .zip(self.features.chunks_exact(self.feature_channels));
        Ok(Some(
            rows.flat_map(|(rgb, features)| rgb.iter().chain(features).copied())
                .collect(),
        ))
    }

    /// Gradients in the order of [`RasterTensors`].
    fn backward(
        &self,
        call: &RasterCall,
        forward: &Forward<E>,
        pixels: PixelGradients<'_, E>,
    ) -> [Vec<E>; INPUTS] {
        let projected = &forward.projected;
        let colours = call.colours();
        let channels = colours + self.feature_channels;
        let values = forward.values.as_deref().unwrap_or(&self.features);
        let mut d = projected.backward(
            &self.splats(),
            values,
            channels,
            pixels,
            call.absolute_screen,
        );
        let d_sh = if let Some(harmonics) = self.harmonics(call) {
            let radii = projected.radii();
            harmonics.backward(values, &d.values, channels, radii, &mut d.means)
        } else {
            Vec::new()
        };
        let d_features = if channels == colours {
            Vec::new()
        } else if colours == 0 {
            d.values
        } else {
            d.values
                .chunks_exact(channels)
                .flat_map(|row| &row[colours..])
                .copied()
                .collect()
        };
        let d_screen = if call.absolute_screen {
            let sums = d.screen_absolute.as_chunks::<2>().0;
            let rows = d.screen.as_chunks::<2>().0.iter().zip(sums);
            rows.flat_map(|(&[u, v], &[sum_u, sum_v])| [u, v, sum_u, sum_v])
                .collect()
        } else {
            d.screen
        };
        [
            d.means,
            d.log_scales,
            d.rotations,
            d.opacity_logits,
            d_sh,
            d_features,
            d_screen,
        ]
    }
}
