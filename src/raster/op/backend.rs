//! The operation on backends that lend their tensors to host kernels.

use super::call::{Forward, HostInputs, RasterCall};
use crate::ops::{HostBackend, device_of, real_kernel};
use burn::backend::{Backend, ExtensionType, TensorMetadata, backend_extension, tensor::FloatTensor};
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
        let [means, log_scales, rotations, opacity_logits, sh, features, screen] = tensors;
        Self { means, log_scales, rotations, opacity_logits, sh, features, screen }
    }

    pub(super) fn into_array(self) -> [FloatTensor<B>; INPUTS] {
        let Self { means, log_scales, rotations, opacity_logits, sh, features, screen } = self;
        [means, log_scales, rotations, opacity_logits, sh, features, screen]
    }
}

/// Backend side of [`super::rasterize`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "wgpu"),
    Autodiff
)]
pub trait RasterBackend: Backend {
    /// The image `[H, W, C]`; leaves the rest of the forward pass in `call`.
    fn raster_image(#[extension_type] tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self>;
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

impl<B: HostBackend> RasterBackend for B {
    fn raster_image(tensors: RasterTensors<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let device = device_of::<B>(&tensors.means);
        let channels = call.colours() + tensors.features.shape().dims::<2>()[1];
        let [w, h] = call.size();
        real_kernel!(tensors.means, E => {
            let image = match HostInputs::<E>::read::<B>(tensors).forward(&call) {
                Ok((image, forward)) => {
                    let mut state = call.state();
                    state.radii = Arc::new(forward.projected.radii().to_vec());
                    state.forward = Some(Box::new(forward));
                    image
                }
                Err(error) => {
                    call.state().error = Some(error);
                    vec![E::default(); w * h * channels]
                }
            };
            B::tensor::<E>(image, &[h, w, channels], &device)
        })
    }

    fn raster_transmittance(image: FloatTensor<Self>, call: Arc<RasterCall>) -> FloatTensor<Self> {
        let device = device_of::<B>(&image);
        let [w, h] = call.size();
        real_kernel!(image, E => {
            let state = call.state();
            let forward = state.forward.as_ref().and_then(|f| f.downcast_ref::<Forward<E>>());
            let values = forward.map_or_else(|| vec![E::default(); w * h], |f| f.transmittance.clone());
            B::tensor::<E>(values, &[h, w], &device)
        })
    }

    fn raster_transmittance_backward(
        image: FloatTensor<Self>,
        d_transmittance: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> FloatTensor<Self> {
        let (device, shape) = (device_of::<B>(&image), image.shape());
        real_kernel!(image, E => {
            call.state().d_transmittance = Some(Box::new(B::values::<E>(d_transmittance).into_vec()));
            B::tensor::<E>(vec![E::default(); shape.num_elements()], &shape.dims::<3>(), &device)
        })
    }

    fn raster_backward(
        tensors: RasterTensors<Self>,
        image: FloatTensor<Self>,
        d_image: FloatTensor<Self>,
        call: Arc<RasterCall>,
    ) -> RasterTensors<Self> {
        let device = device_of::<B>(&image);
        let tensors = tensors.into_array();
        let shapes = tensors.each_ref().map(|t| t.shape());
        real_kernel!(image, E => {
            let forward: Option<Forward<E>> = RasterCall::take(&mut call.state().forward);
            let inputs = HostInputs::<E>::read::<B>(RasterTensors::from_array(tensors));
            let gradients = match forward {
                Some(forward) => inputs.backward(&call, forward, &B::values(image), &B::values(d_image)),
                // Only after an error, which the caller of `rasterize` has in hands.
                None => shapes.each_ref().map(|s| vec![E::default(); s.num_elements()]),
            };
            let mut at = 0;
            RasterTensors::from_array(gradients.map(|values| {
                let shape = &shapes[at];
                at += 1;
                // No screen tensor given: its gradient goes nowhere.
                let shape = if shape.num_elements() == values.len() { shape.to_vec() } else { vec![values.len()] };
                B::tensor::<E>(values, &shape, &device)
            }))
        })
    }
}
