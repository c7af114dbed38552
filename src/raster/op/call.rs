//! One call of the operation on the host: slices in, slices out.

use super::backend::{INPUTS, RasterTensors};
use super::radii::Radii;
use crate::backend::{HostBackend, HostValues, Real};
use crate::error::{Error, Result};
use crate::raster::cpu::backward::{PixelGradients, SplatGradients};
use crate::raster::cpu::projected::{Blended, Projected};
use crate::raster::cpu::sh::{ShBackward, visible_colours};
use crate::raster::settings::{Settings, Splats, check_finite};
use crate::splat::camera::Camera;
use std::any::Any;
use std::sync::{Mutex, PoisonError};

/// Host side of one call: what it is asked, and what the forward pass leaves for the backward pass, so that nothing is
/// projected twice.
#[derive(Debug)]
pub struct RasterCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
    pub(super) background: [f64; 3],
    pub(super) has_sh: bool,
    pub(super) has_features: bool,
    pub(super) sh_degree: usize,
    pub(super) active_sh_degree: usize,
    /// Whether the gradient of the screen has the columns of AbsGS too.
    pub(super) absolute_screen: bool,
    #[cfg_attr(
        not(feature = "cube"),
        allow(dead_code, reason = "no other kernels than the host's are compiled in")
    )]
    pub(super) way: Way,
    pub(super) state: Mutex<CallState>,
}

/// How a call is carried out where tensors live on a GPU.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(
    not(feature = "cube"),
    allow(dead_code, reason = "no other kernels than the host's are compiled in")
)]
pub(super) struct Way {
    /// By the host's kernels all the same.
    pub host_kernels: bool,
    /// How many tile entries to make room for, instead of asking for their number.
    pub room: Option<usize>,
}

#[derive(Debug, Default)]
pub(super) struct CallState {
    pub radii: Radii,
    /// A [`Forward`] of the element type of the tensors, or what the GPU kernels leave.
    pub forward: Option<Box<dyn Any + Send>>,
    /// dL/dT of the transmittance output, a `Vec` of the element type or a tensor on the device.
    pub d_transmittance: Option<Box<dyn Any + Send>>,
    pub error: Option<Error>,
}

/// What the forward pass computed.
pub(super) struct Forward<E> {
    pub projected: Projected<E>,
    /// Blended values, `[N, channels]`; `None` where they are the features tensor itself.
    pub values: Option<Vec<E>>,
    pub transmittance: Vec<E>,
}

impl RasterCall {
    pub(super) fn state(&self) -> std::sync::MutexGuard<'_, CallState> {
        // A panic elsewhere cannot leave the plain fields behind the lock half-written.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn take<T: 'static>(slot: &mut Option<Box<dyn Any + Send>>) -> Option<T> {
        slot.take()?.downcast().ok().map(|b| *b)
    }

    pub(super) fn size(&self) -> [usize; 2] {
        [self.camera.width, self.camera.height]
    }

    pub(super) fn colours(&self) -> usize {
        if self.has_sh { 3 } else { 0 }
    }
}

/// Slices of the inputs.
pub(super) struct HostInputs<E> {
    means: HostValues<E>,
    log_scales: HostValues<E>,
    rotations: HostValues<E>,
    opacity_logits: HostValues<E>,
    sh: HostValues<E>,
    features: HostValues<E>,
}

impl<E: Real> HostInputs<E> {
    pub fn read<B: HostBackend>(tensors: RasterTensors<B>) -> Self {
        Self {
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

    fn features_per_row(&self) -> usize {
        self.features.len() / self.opacity_logits.len().max(1)
    }

    /// Image `[H, W, channels]`, background included, and what the backward pass needs.
    pub fn forward(&self, call: &RasterCall) -> Result<(Vec<E>, Forward<E>)> {
        check_finite("features", &self.features, self.features_per_row())?;
        let projected = Projected::new(&self.splats(), &call.camera, &call.settings)?;
        let colours = call.colours();
        let extra = self.features_per_row();
        let channels = colours + extra;
        let center = call.camera.center.to_array();
        let colours_of = |radii| {
            visible_colours(
                &self.means,
                &self.sh,
                call.sh_degree,
                call.active_sh_degree,
                center,
                radii,
            )
        };
        let mut values = if call.has_sh {
            Some(colours_of(projected.radii())?)
        } else {
            None
        };
        if let (Some(rgb), true) = (&values, extra > 0) {
            let rows = rgb.chunks_exact(3).zip(self.features.chunks_exact(extra));
            values = Some(
                rows.flat_map(|(rgb, features)| rgb.iter().chain(features).copied())
                    .collect(),
            );
        }
        let Blended {
            mut image,
            transmittance,
        } = projected.blend(values.as_deref().unwrap_or(&self.features), channels);
        let background = call.background.map(E::of);
        if colours > 0 && background != [E::zero(); 3] {
            for (pixel, &t) in image.chunks_exact_mut(channels).zip(&transmittance) {
                for (value, &b) in pixel.iter_mut().zip(&background) {
                    *value += t * b;
                }
            }
        }
        Ok((
            image,
            Forward {
                projected,
                values,
                transmittance,
            },
        ))
    }

    /// Gradients in the order of [`RasterTensors`].
    pub fn backward(
        &self,
        call: &RasterCall,
        forward: Forward<E>,
        image: &[E],
        d_image: &[E],
    ) -> [Vec<E>; INPUTS] {
        let Forward {
            projected,
            values,
            transmittance,
        } = forward;
        let d_transmittance: Option<Vec<E>> = RasterCall::take(&mut call.state().d_transmittance);
        let n = self.opacity_logits.len();
        let colours = call.colours();
        let channels = colours + self.features_per_row();
        let pixels = PixelGradients {
            image,
            transmittance: &transmittance,
            d_image,
            d_transmittance: d_transmittance.as_deref(),
        };
        let values = values.as_deref().unwrap_or(&self.features);
        let absolute = call.absolute_screen;
        let SplatGradients {
            mut means,
            log_scales,
            rotations,
            opacity_logits,
            values: d_values,
            screen,
            screen_absolute,
        } = projected.backward_slices(&self.splats(), values, channels, pixels, absolute);
        let d_sh = if call.has_sh {
            ShBackward {
                means: &self.means,
                sh: &self.sh,
                sh_degree: call.sh_degree,
                active_degree: call.active_sh_degree,
                center: call.camera.center.to_array(),
                colours: values,
                gradient: &d_values,
                stride: channels,
                wanted: projected.radii(),
            }
            .run(&mut means)
        } else {
            Vec::new()
        };
        let d_features = match (call.has_sh, call.has_features) {
            (_, false) => Vec::new(),
            (false, true) => d_values,
            (true, true) if channels > colours => {
                let mut out = Vec::with_capacity(n * (channels - colours));
                d_values
                    .chunks_exact(channels)
                    .for_each(|row| out.extend_from_slice(&row[colours..]));
                out
            }
            (true, true) => Vec::new(),
        };
        let d_screen = if absolute {
            let rows = screen
                .as_chunks::<2>()
                .0
                .iter()
                .zip(screen_absolute.as_chunks::<2>().0);
            rows.flat_map(|(&[u, v], &[sum_u, sum_v])| [u, v, sum_u, sum_v])
                .collect()
        } else {
            screen
        };
        [
            means,
            log_scales,
            rotations,
            opacity_logits,
            d_sh,
            d_features,
            d_screen,
        ]
    }
}
