//! The adjoint of blending, and the counter of Algorithm 1, as an operation on tensors.

use super::splats::SplatTensors;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::{HostBackend, HostKernels, Real, device_of, real_kernel};
use crate::raster::projected::Projected;
use crate::raster::settings::{Settings, Splats};
use burn::backend::{Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension, tensor::FloatTensor};
use burn::tensor::Tensor;
use std::sync::{Arc, Mutex, PoisonError};

/// What [`SplatTensors::adjoint`] gives.
#[derive(Clone, Debug)]
pub struct Lifted {
    /// `W^T y`, `[N, C]`.
    pub sums: Tensor<2>,
    /// Pixels whose centre lies within the projected radius, `[N]`, as floats.
    pub counts: Tensor<1>,
}

/// Geometry and image of one call.
#[derive(Clone, Debug, ExtensionType)]
pub struct AdjointTensors<B: Backend> {
    pub(super) means: FloatTensor<B>,
    pub(super) log_scales: FloatTensor<B>,
    pub(super) rotations: FloatTensor<B>,
    pub(super) opacity_logits: FloatTensor<B>,
    pub(super) image: FloatTensor<B>,
}

/// What the operation is asked, and the error that it may leave.
#[derive(Debug)]
pub struct AdjointCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
    error: Mutex<Option<Error>>,
}

impl AdjointCall {
    pub(super) fn fail(&self, error: Error) {
        *self.error.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
    }
}

/// Backend side of [`SplatTensors::adjoint`].
#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"))]
pub trait AdjointBackend: Backend {
    /// `W^T y` `[N, C]` and counts `[N]`; anything after an error, which `call` keeps.
    fn raster_adjoint(
        #[extension_type] tensors: AdjointTensors<Self>,
        call: Arc<AdjointCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostKernels> AdjointBackend for B {
    fn raster_adjoint(tensors: AdjointTensors<Self>, call: Arc<AdjointCall>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::<Self>(tensors, &call)
    }
}

/// The operation by the CPU's kernels, wherever the tensors live.
pub(super) fn on_host<B: HostBackend>(
    tensors: AdjointTensors<B>,
    call: &AdjointCall,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let AdjointTensors { means, log_scales, rotations, opacity_logits, image } = tensors;
    let (device, channels) = (device_of::<B>(&image), image.shape()[2]);
    real_kernel!(image, E => {
        let [means, log_scales, rotations, opacity_logits, image] =
            [means, log_scales, rotations, opacity_logits, image].map(B::values::<E>);
        let n = opacity_logits.len();
        let splats = Splats {
            means: &means,
            log_scales: &log_scales,
            rotations: &rotations,
            opacity_logits: &opacity_logits,
        };
        let (sums, counts) = match Projected::new(&splats, &call.camera, &call.settings) {
            Ok(projected) => {
                let counts = projected.counts().into_iter().map(|count| E::of(f64::from(count))).collect();
                (projected.blend_adjoint(&image, channels), counts)
            }
            Err(error) => {
                call.fail(error);
                (vec![E::default(); n * channels], vec![E::default(); n])
            }
        };
        (B::tensor::<E>(sums, &[n, channels], &device), B::tensor::<E>(counts, &[n], &device))
    })
}

impl SplatTensors {
    /// `W^T y` of an image `y`, `[H, W, C]`: the adjoint of [`SplatTensors::blend`], without autodiff.
    ///
    /// # Errors
    /// [`Error::Config`] for an image of another size than `camera` has; those of [`Projected::new`]; on a GPU
    /// [`Error::Limit`] for what the device cannot hold, and [`Error::Device`] when it fails.
    pub fn adjoint(&self, image: Tensor<3>, camera: &Camera, settings: &Settings) -> Result<Lifted> {
        let [height, width, _] = image.dims();
        if [height, width] != [camera.height, camera.width] {
            let (found, expected) = (format!("{width}x{height}"), format!("{}x{}", camera.width, camera.height));
            return Err(Error::config("image to lift", found, expected, "pass an image of the camera's size"));
        }
        let call = Arc::new(AdjointCall { camera: camera.clone(), settings: *settings, error: Mutex::default() });
        let tensors = AdjointTensors {
            means: self.means.clone().into_dispatch(),
            log_scales: self.log_scales.clone().into_dispatch(),
            rotations: self.rotations.clone().into_dispatch(),
            opacity_logits: self.opacity_logits.clone().into_dispatch(),
            image: image.into_dispatch(),
        };
        let (sums, counts) = Dispatch::raster_adjoint(tensors, call.clone());
        if let Some(error) = call.error.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error);
        }
        Ok(Lifted { sums: Tensor::from_dispatch(sums), counts: Tensor::from_dispatch(counts) })
    }
}
