//! The adjoint of blending, and the counter of Algorithm 1, as an operation on tensors.

use super::splats::{SplatTensors, channel_blocks};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::{HostBackend, HostKernels, Real, device_of, real_kernel};
use crate::raster::projected::Projected;
use crate::raster::settings::{Settings, Splats};
use burn::backend::{Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension, tensor::FloatTensor};
use burn::tensor::Tensor;
use std::any::Any;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What [`SplatView::adjoint`] gives.
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

/// What the operation is asked, what it keeps from one image to the next, and the error that it may leave.
#[derive(Debug)]
pub struct AdjointCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Projection and tile lists, made for the first image.
    prepared: Option<Box<dyn Any + Send>>,
    error: Option<Error>,
}

impl AdjointCall {
    fn state(&self) -> MutexGuard<'_, State> {
        // A panic elsewhere cannot leave the plain fields behind the lock half-written.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn fail(&self, error: Error) {
        self.state().error = Some(error);
    }

    /// What `make` makes for the first image; `None` where that has nothing to give.
    pub(super) fn prepared<T: Send + 'static, R>(
        &self,
        make: impl FnOnce() -> Result<Option<T>>,
        then: impl FnOnce(&T) -> Result<R>,
    ) -> Result<Option<R>> {
        let mut state = self.state();
        if !state.prepared.as_ref().is_some_and(|kept| kept.is::<T>()) {
            state.prepared = match make()? {
                Some(made) => Some(Box::new(made)),
                None => return Ok(None),
            };
        }
        state.prepared.as_ref().and_then(|kept| kept.downcast_ref()).map(then).transpose()
    }
}

/// Backend side of [`SplatView::adjoint`].
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
        let lift = |projected: &Projected<E>| -> Result<(Vec<E>, Vec<E>)> {
            let counts = projected.counts().into_iter().map(|count| E::of(f64::from(count))).collect();
            Ok((projected.blend_adjoint(&image, channels), counts))
        };
        let made = || Projected::new(&splats, &call.camera, &call.settings).map(Some);
        let (sums, counts) = match call.prepared(made, lift) {
            Ok(Some(found)) => found,
            other => {
                // `made` always makes something.
                if let Err(error) = other {
                    call.fail(error);
                }
                (vec![E::default(); n * channels], vec![E::default(); n])
            }
        };
        (B::tensor::<E>(sums, &[n, channels], &device), B::tensor::<E>(counts, &[n], &device))
    })
}

/// Frozen Gaussians and a camera: projected and sorted once for all images that are lifted.
#[derive(Clone, Debug)]
pub struct SplatView {
    splats: SplatTensors,
    call: Arc<AdjointCall>,
}

impl SplatTensors {
    /// These Gaussians as `camera` sees them.
    pub fn seen_by(&self, camera: &Camera, settings: &Settings) -> SplatView {
        let call = AdjointCall { camera: camera.clone(), settings: *settings, state: Mutex::default() };
        SplatView { splats: self.clone(), call: Arc::new(call) }
    }

    /// [`SplatView::adjoint`] of one image.
    ///
    /// # Errors
    /// As [`SplatView::adjoint`].
    pub fn adjoint(&self, image: Tensor<3>, camera: &Camera, settings: &Settings) -> Result<Lifted> {
        self.seen_by(camera, settings).adjoint(image)
    }
}

impl SplatView {
    /// Where it is seen from.
    pub fn camera(&self) -> &Camera {
        &self.call.camera
    }

    /// Ranges of `channels`, so many together that an image of them takes 64 MB or little more.
    pub fn channel_blocks(&self, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        channel_blocks(self.camera(), channels)
    }

    /// `W^T y` of an image `y`, `[H, W, C]`: the adjoint of [`SplatTensors::blend`], without autodiff.
    ///
    /// # Errors
    /// [`Error::Config`] for an image of another size than the camera has, or tensors of different sizes or float types; those
    /// of [`Projected::new`]; on a GPU [`Error::Limit`] for what the device cannot hold, and [`Error::Device`] when it fails.
    pub fn adjoint(&self, image: Tensor<3>) -> Result<Lifted> {
        let (camera, splats) = (self.camera(), &self.splats);
        let [height, width, _] = image.dims();
        if [height, width] != [camera.height, camera.width] {
            let (found, expected) = (format!("{width}x{height}"), format!("{}x{}", camera.width, camera.height));
            return Err(Error::config("image to lift", found, expected, "pass an image of the camera's size"));
        }
        splats.check(image.dtype())?;
        let tensors = AdjointTensors {
            means: splats.means.clone().into_dispatch(),
            log_scales: splats.log_scales.clone().into_dispatch(),
            rotations: splats.rotations.clone().into_dispatch(),
            opacity_logits: splats.opacity_logits.clone().into_dispatch(),
            image: image.into_dispatch(),
        };
        let (sums, counts) = Dispatch::raster_adjoint(tensors, self.call.clone());
        match self.call.state().error.take() {
            Some(error) => Err(error),
            None => Ok(Lifted { sums: Tensor::from_dispatch(sums), counts: Tensor::from_dispatch(counts) }),
        }
    }
}
