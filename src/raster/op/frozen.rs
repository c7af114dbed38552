//! Blending with frozen geometry and its adjoint, as operations on tensors: projected and sorted once a view.

use super::splats::SplatTensors;
use crate::backend::device::largest_allocation;
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use crate::error::{Error, Result};
use crate::ops::{RowList, gather_rows};
use crate::raster::cpu::projected::{Blended, Projected};
use crate::raster::settings::{Settings, Splats};
use crate::splat::camera::Camera;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, AutodiffBackend, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension,
    tensor::FloatTensor,
};
use burn::tensor::Tensor;
use std::any::Any;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Bytes of an image of several channels, where they need not lie together, in host memory.
const BLOCK_BYTES: usize = 64 << 20;
/// The most that such an image takes on a device, and the share of its largest allocation.
const DEVICE_BLOCK_BYTES: usize = 1 << 30;
const DEVICE_BLOCK_SHARE: usize = 4;
/// Blocks of a device are cut between so many channels.
const DEVICE_STEP: usize = 32;
/// Channels that are always blended together, however large the image: each pass evaluates all pairs anew.
const LEAST_CHANNELS: usize = 12;

/// What [`SplatView::adjoint`] gives.
#[derive(Clone, Debug)]
pub struct Lifted {
    /// `W^T y`, `[N, C]`.
    pub sums: Tensor<2>,
    /// Pixels whose centre lies within the projected radius, `[N]`, as floats.
    pub counts: Tensor<1>,
}

/// Geometry, and what is blended (`[N, C]`) or lifted (`[H, W, C]`).
#[derive(Clone, Debug, ExtensionType)]
pub struct FrozenTensors<B: Backend> {
    pub(super) means: FloatTensor<B>,
    pub(super) log_scales: FloatTensor<B>,
    pub(super) rotations: FloatTensor<B>,
    pub(super) opacity_logits: FloatTensor<B>,
    pub(super) operand: FloatTensor<B>,
}

/// What the operations are asked, what they keep from one call to the next, and the error that one may leave.
#[derive(Debug)]
pub struct FrozenCall {
    pub(super) camera: Camera,
    pub(super) settings: Settings,
    /// Entries of the tile lists, once a GPU has made them, here or for the same Gaussians and camera before.
    pub(super) entries: Arc<OnceLock<usize>>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Projection and tile lists, made at first use.
    prepared: Option<Box<dyn Any + Send>>,
    error: Option<Error>,
}

impl FrozenCall {
    fn state(&self) -> MutexGuard<'_, State> {
        // A panic elsewhere cannot leave the plain fields behind the lock half-written.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn fail(&self, error: Error) {
        self.state().error = Some(error);
    }

    /// What `then` makes of what `make` makes at first use; `None` where that has nothing to give.
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
        state
            .prepared
            .as_ref()
            .and_then(|kept| kept.downcast_ref())
            .map(then)
            .transpose()
    }
}

/// Backend side of [`SplatView`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait FrozenBackend: Backend {
    /// The image `[H, W, C]` and the transmittance `[H, W]`; anything after an error, which `call` keeps.
    fn frozen_blend(
        #[extension_type] tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
    /// `W^T y` `[N, C]` and counts `[N]`; anything after an error, which `call` keeps.
    fn frozen_adjoint(
        #[extension_type] tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostKernels> FrozenBackend for B {
    fn frozen_blend(
        tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::blend::<Self>(tensors, &call)
    }

    fn frozen_adjoint(
        tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::adjoint::<Self>(tensors, &call)
    }
}

/// The operations by the CPU's kernels, wherever the tensors live.
pub(super) mod on_host {
    use super::*;

    pub fn blend<B: HostBackend>(
        tensors: FrozenTensors<B>,
        call: &FrozenCall,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, channels) = (device_of::<B>(&tensors.operand), tensors.operand.shape()[1]);
        let [h, w] = [call.camera.height, call.camera.width];
        real_kernel!(tensors.operand, E => {
            let values = B::values::<E>(tensors.operand.clone());
            let Blended { image, transmittance } = with_projected::<B, E, _>(tensors, call, |p| p.blend(&values, channels))
                .unwrap_or_else(|| Blended {
                    image: vec![E::default(); h * w * channels],
                    transmittance: vec![E::default(); h * w],
                });
            (B::tensor::<E>(image, &[h, w, channels], &device), B::tensor::<E>(transmittance, &[h, w], &device))
        })
    }

    pub fn adjoint<B: HostBackend>(
        tensors: FrozenTensors<B>,
        call: &FrozenCall,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, channels) = (device_of::<B>(&tensors.operand), tensors.operand.shape()[2]);
        let n = tensors.opacity_logits.shape()[0];
        real_kernel!(tensors.operand, E => {
            let image = B::values::<E>(tensors.operand.clone());
            let lift = |projected: &Projected<E>| {
                let counts = projected.counts().into_iter().map(|count| E::of(f64::from(count))).collect();
                (projected.blend_adjoint(&image, channels), counts)
            };
            let (sums, counts): (Vec<E>, Vec<E>) = with_projected::<B, E, _>(tensors, call, lift)
                .unwrap_or_else(|| (vec![E::default(); n * channels], vec![E::default(); n]));
            (B::tensor::<E>(sums, &[n, channels], &device), B::tensor::<E>(counts, &[n], &device))
        })
    }

    /// What `then` makes of the projected Gaussians; nothing after an error, which `call` keeps.
    fn with_projected<B: HostBackend, E: Real, R>(
        tensors: FrozenTensors<B>,
        call: &FrozenCall,
        then: impl FnOnce(&Projected<E>) -> R,
    ) -> Option<R> {
        let FrozenTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
            ..
        } = tensors;
        let made = || {
            let [means, log_scales, rotations, opacity_logits] =
                [means, log_scales, rotations, opacity_logits].map(B::values::<E>);
            let splats = Splats {
                means: &means,
                log_scales: &log_scales,
                rotations: &rotations,
                opacity_logits: &opacity_logits,
            };
            Projected::new(&splats, &call.camera, &call.settings).map(Some)
        };
        call.prepared(made, |projected| Ok(then(projected)))
            .unwrap_or_else(|error| {
                call.fail(error);
                None
            })
    }
}

#[derive(Debug)]
struct FrozenBackward;

impl<B: FrozenBackend> Backward<B, 1> for FrozenBackward {
    type State = (FrozenTensors<B>, Arc<FrozenCall>);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let d_image = grads.consume::<B>(&ops.node);
        let (tensors, call) = ops.state;
        let [parent] = ops.parents;
        if let Some(node) = parent {
            let (d_values, _) = B::frozen_adjoint(
                FrozenTensors {
                    operand: d_image,
                    ..tensors
                },
                call,
            );
            grads.register::<B>(node.id, d_values);
        }
    }
}

impl<B: FrozenBackend, C: CheckpointStrategy> FrozenBackend for Autodiff<B, C> {
    fn frozen_blend(
        tensors: FrozenTensors<Self>,
        call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let FrozenTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
            operand,
        } = tensors;
        let (operand, node) = operand.into_parts();
        let [means, log_scales, rotations, opacity_logits] =
            [means, log_scales, rotations, opacity_logits].map(|t| t.into_parts().0);
        let tensors = FrozenTensors::<B> {
            means,
            log_scales,
            rotations,
            opacity_logits,
            operand,
        };
        let (image, transmittance) = B::frozen_blend(tensors.clone(), call.clone());
        let transmittance = <Self as AutodiffBackend>::from_inner(transmittance);
        let image = match FrozenBackward
            .prepare::<C>([node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => prep.finish((tensors, call), image),
            OpsKind::UnTracked(prep) => prep.finish(image),
        };
        (image, transmittance)
    }

    fn frozen_adjoint(
        _tensors: FrozenTensors<Self>,
        _call: Arc<FrozenCall>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        unimplemented!("second-order gradients")
    }
}

/// Frozen Gaussians and a camera: projected and sorted once for all that is blended and lifted.
#[derive(Clone, Debug)]
pub struct SplatView {
    splats: SplatTensors,
    call: Arc<FrozenCall>,
}

impl SplatTensors {
    /// These Gaussians as `camera` sees them.
    pub fn seen_by(&self, camera: &Camera, settings: &Settings) -> SplatView {
        self.seen_again_by(camera, settings, &Arc::default())
    }

    /// [`SplatTensors::seen_by`], once more: `entries` is that of the calls before with these very Gaussians, camera and settings,
    /// or new. A GPU that has made the lists before reads nothing back then.
    pub(crate) fn seen_again_by(
        &self,
        camera: &Camera,
        settings: &Settings,
        entries: &Arc<OnceLock<usize>>,
    ) -> SplatView {
        let (camera, entries) = (camera.clone(), entries.clone());
        let call = FrozenCall {
            camera,
            settings: *settings,
            entries,
            state: Mutex::default(),
        };
        SplatView {
            splats: self.clone(),
            call: Arc::new(call),
        }
    }
}

impl SplatView {
    /// The Gaussians.
    pub fn splats(&self) -> &SplatTensors {
        &self.splats
    }

    /// Where it is seen from.
    pub fn camera(&self) -> &Camera {
        &self.call.camera
    }

    /// Ranges of `channels`, so many together that an image of them takes 64 MB or little more; on a GPU a quarter of its
    /// largest allocation, and no more than 1 GB.
    pub fn channel_blocks(&self, channels: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let plane = (self.camera().width * self.camera().height * size_of::<f32>()).max(1);
        let together = match largest_allocation(&self.splats.means.device()) {
            None => (BLOCK_BYTES / plane).max(LEAST_CHANNELS),
            Some(most) => match (most / DEVICE_BLOCK_SHARE).min(DEVICE_BLOCK_BYTES) / plane {
                few if few < DEVICE_STEP => few.max(LEAST_CHANNELS),
                many => many / DEVICE_STEP * DEVICE_STEP,
            },
        };
        (0..channels)
            .step_by(together)
            .map(move |first| first..(first + together).min(channels))
    }

    /// `S = W s` of `values` `[N, C]`, the image `[H, W, C]` with gradient to them, and the transmittance `[H, W]` (Eq. 3-4).
    ///
    /// # Errors
    /// [`Error::Argument`] for tensors of different sizes or float types; those of [`Projected::new`]; on a GPU [`Error::Limit`]
    /// for what the device cannot hold, and [`Error::Device`] when it fails, also in the backward pass of an earlier call.
    pub fn blend(&self, values: Tensor<2>) -> Result<(Tensor<3>, Tensor<2>)> {
        let (n, rows) = (self.splats.len(), values.dims()[0]);
        if rows != n {
            let (found, expected) = (format!("{rows} rows"), format!("{n}, one a Gaussian"));
            return Err(Error::argument(
                "values to blend",
                found,
                expected,
                "pass values of these Gaussians",
            ));
        }
        self.splats.check(values.dtype())?;
        let tensors = self.tensors(values.device().is_autodiff(), values.into_dispatch());
        let (image, transmittance) = Dispatch::frozen_blend(tensors, self.call.clone());
        self.unless_failed((
            Tensor::from_dispatch(image),
            Tensor::from_dispatch(transmittance),
        ))
    }

    /// [`SplatView::blend`] at the pixels `pixels` (row-major): `[P, C]` and `[P]`. Where all pixels of all channels would take
    /// much memory, channels are blended a block at a time.
    ///
    /// # Errors
    /// As [`SplatView::blend`].
    pub fn blend_at(
        &self,
        values: Tensor<2>,
        pixels: &Arc<RowList>,
    ) -> Result<(Tensor<2>, Tensor<1>)> {
        let (n, all) = (values.dims()[0], self.camera().width * self.camera().height);
        let mut transmittance = None;
        let blocks = self.channel_blocks(values.dims()[1]).map(|block| {
            let channels = block.len();
            let (image, of_all) = self.blend(values.clone().slice([0..n, block]))?;
            transmittance.get_or_insert(of_all);
            Ok(gather_rows(image.reshape([all, channels]), pixels))
        });
        let image = Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1);
        let transmittance = match transmittance {
            Some(transmittance) => transmittance.reshape([all, 1]),
            None => Tensor::ones([all, 1], &image.device()),
        };
        Ok((
            image,
            gather_rows(transmittance, pixels).reshape([pixels.len()]),
        ))
    }

    /// `W^T y` of an image `y`, `[H, W, C]`: the adjoint of [`SplatView::blend`], without autodiff.
    ///
    /// # Errors
    /// [`Error::Argument`] for an image of another size than the camera has; as [`SplatView::blend`].
    pub fn adjoint(&self, image: Tensor<3>) -> Result<Lifted> {
        let camera = self.camera();
        let [height, width, _] = image.dims();
        if [height, width] != [camera.height, camera.width] {
            let (found, expected) = (
                format!("{width}x{height}"),
                format!("{}x{}", camera.width, camera.height),
            );
            return Err(Error::argument(
                "image to lift",
                found,
                expected,
                "pass an image of the camera's size",
            ));
        }
        self.splats.check(image.dtype())?;
        let (sums, counts) = Dispatch::frozen_adjoint(
            self.tensors(false, image.into_dispatch()),
            self.call.clone(),
        );
        self.unless_failed(Lifted {
            sums: Tensor::from_dispatch(sums),
            counts: Tensor::from_dispatch(counts),
        })
    }

    /// The geometry beside `operand`, on its autodiff device where it is `tracked`.
    fn tensors(&self, tracked: bool, operand: FloatTensor<Dispatch>) -> FrozenTensors<Dispatch> {
        fn beside<const D: usize>(frozen: &Tensor<D>, tracked: bool) -> FloatTensor<Dispatch> {
            if tracked {
                Tensor::from_inner(frozen.clone()).into_dispatch()
            } else {
                frozen.clone().into_dispatch()
            }
        }
        let SplatTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
        } = &self.splats;
        FrozenTensors {
            means: beside(means, tracked),
            log_scales: beside(log_scales, tracked),
            rotations: beside(rotations, tracked),
            opacity_logits: beside(opacity_logits, tracked),
            operand,
        }
    }

    fn unless_failed<T>(&self, found: T) -> Result<T> {
        match self.call.state().error.take() {
            Some(error) => Err(error),
            None => Ok(found),
        }
    }
}
