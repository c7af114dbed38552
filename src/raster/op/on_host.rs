//! The operation by the host's kernels: slices from tensors, tensors from slices.

use super::backend::RasterTensors;
use super::call::{Forward, HostInputs, RasterCall};
use super::radii::Radii;
use crate::backend::{HostBackend, device_of, real_kernel};
use burn::backend::{TensorMetadata, tensor::FloatTensor};
use std::sync::Arc;

pub(super) fn image<B: HostBackend>(
    tensors: RasterTensors<B>,
    call: Arc<RasterCall>,
) -> FloatTensor<B> {
    let device = device_of::<B>(&tensors.means);
    let channels = call.colours() + tensors.features.shape().dims::<2>()[1];
    let [w, h] = call.size();
    real_kernel!(tensors.means, E => {
        let image = match HostInputs::<E>::read::<B>(tensors).forward(&call) {
            Ok((image, forward)) => {
                let mut state = call.state();
                state.radii = Radii::on_host(forward.projected.radii().to_vec());
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

/// For what the call has, or only a device.
pub(super) fn nothing<B: HostBackend>(image: FloatTensor<B>) -> FloatTensor<B> {
    B::tensor::<f32>(Vec::new(), &[0], &device_of::<B>(&image))
}

pub(super) fn transmittance<B: HostBackend>(
    image: FloatTensor<B>,
    call: Arc<RasterCall>,
) -> FloatTensor<B> {
    let device = device_of::<B>(&image);
    let [w, h] = call.size();
    real_kernel!(image, E => {
        let state = call.state();
        let forward = state.forward.as_ref().and_then(|f| f.downcast_ref::<Forward<E>>());
        let values = forward.map_or_else(|| vec![E::default(); w * h], |f| f.transmittance.clone());
        B::tensor::<E>(values, &[h, w], &device)
    })
}

pub(super) fn transmittance_backward<B: HostBackend>(
    image: FloatTensor<B>,
    d_transmittance: FloatTensor<B>,
    call: Arc<RasterCall>,
) -> FloatTensor<B> {
    let (device, shape) = (device_of::<B>(&image), image.shape());
    real_kernel!(image, E => {
        call.state().d_transmittance = Some(Box::new(B::values::<E>(d_transmittance).into_vec()));
        B::tensor::<E>(vec![E::default(); shape.num_elements()], &shape.dims::<3>(), &device)
    })
}

pub(super) fn backward<B: HostBackend>(
    tensors: RasterTensors<B>,
    image: FloatTensor<B>,
    d_image: FloatTensor<B>,
    call: Arc<RasterCall>,
) -> RasterTensors<B> {
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
