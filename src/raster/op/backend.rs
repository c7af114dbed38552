//! The operation's trait, and its implementation for backends whose operations are host kernels.

use super::call::RasterCall;
use super::on_host;
use crate::backend::HostKernels;
use burn::backend::{Backend, ExtensionType, backend_extension, tensor::FloatTensor};
use std::sync::Arc;

/// The tensors of one call; absent ones are empty.
#[derive(Clone, Debug, ExtensionType)]
pub struct RasterTensors<B: Backend> {
    pub(super) means: FloatTensor<B>,
    pub(super) log_scales: FloatTensor<B>,
    pub(super) rotations: FloatTensor<B>,
    pub(super) opacity_logits: FloatTensor<B>,
    pub(super) sh: FloatTensor<B>,
    pub(super) features: FloatTensor<B>,
    pub(super) screen: FloatTensor<B>,
}

/// Inputs of the operation, and the index of each among its parents.
pub(super) const INPUTS: usize = 7;

impl<B: Backend> RasterTensors<B> {
    pub(super) fn from_array(tensors: [FloatTensor<B>; INPUTS]) -> Self {
        let [
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        ] = tensors;
        Self {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        }
    }

    pub(super) fn into_array(self) -> [FloatTensor<B>; INPUTS] {
        let Self {
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        } = self;
        [
            means,
            log_scales,
            rotations,
            opacity_logits,
            sh,
            features,
            screen,
        ]
    }
}

/// Backend side of [`super::rasterize`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait RasterBackend: Backend {
    /// The image `[H, W, C]`; leaves the rest of the forward pass in `call`.
    fn raster_image(
        #[extension_type] tensors: RasterTensors<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self>;
    /// Radii `[N]` of the call that made `image`, as floats, where they lie on a device; empty where the call has them.
    fn raster_radii(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
    /// What the call that made `image` found of the tile lists, `[3]`, where it ran on a device; empty where not.
    fn raster_summary(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
    /// The transmittance `[H, W]` of the call that made `image`.
    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
    /// Keeps the gradient of the transmittance for [`RasterBackend::raster_backward`], and returns zeros like `image`.
    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self>;
    /// Gradients of all inputs.
    fn raster_backward(
        #[extension_type] tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self>;
}

/// The operation by the host's kernels.
impl<B: HostKernels> RasterBackend for B {
    fn raster_image(tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        on_host::image::<Self>(tensors, call)
    }
    fn raster_radii(image: FloatTensor<Self>, _call: Arc<RasterCall>) -> FloatTensor<Self> {
        on_host::nothing::<Self>(image)
    }
    fn raster_summary(image: FloatTensor<Self>, _call: Arc<RasterCall>) -> FloatTensor<Self> {
        on_host::nothing::<Self>(image)
    }
    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        on_host::transmittance::<Self>(image, call)
    }
    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self> {
        on_host::transmittance_backward::<Self>(image, d_transmittance, call)
    }
    fn raster_backward(
        tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self> {
        on_host::backward::<Self>(tensors, image, d_image, call)
    }
}
