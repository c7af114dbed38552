//! The photometric loss (1 - w) L1 + w (1 - SSIM) between a rendered image and a photo, fused, with its gradient.
//!
//! SSIM as 3DGS has it: 11x11 Gaussian window of sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, population
//! covariance, mean over pixels and channels. The gradient is written by hand: with
//! S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2)) and every moment a convolution with the
//! symmetric window G, dS/dx = G * dS/dmx + 2 x (G * dS/dxx) + y (G * dS/dxy).

use super::Compared;
use super::photo::{C1, C2, CHANNELS};
use super::window::{RADIUS, TAPS, taps};
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{DType, Tensor, TensorData};
use rayon::prelude::*;

/// Backend side of [`photometric_loss`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait PhotometricBackend: Backend {
    /// (loss `[1]`, gradient `[H, W, 3]` to the image).
    fn photometric(
        image: FloatTensor<Self>,
        photo: Compared,
        ssim_weight: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
    /// `gradient` times the one value of `factor`, in place where nobody else holds the buffer.
    fn photometric_scale(
        gradient: FloatTensor<Self>,
        factor: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
}

impl<B: HostKernels> PhotometricBackend for B {
    fn photometric(
        image: FloatTensor<Self>,
        photo: Compared,
        ssim_weight: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::loss::<Self>(image, &photo, ssim_weight)
    }

    fn photometric_scale(
        gradient: FloatTensor<Self>,
        factor: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let (device, shape) = (device_of::<B>(&gradient), gradient.shape());
        real_kernel!(gradient, E => {
            let factor = B::values::<E>(factor).first().copied().unwrap_or(E::of(1.0));
            let mut values = B::values::<E>(gradient).into_vec();
            // a loss that nothing else is added to: nothing to do
            if factor != E::of(1.0) {
                values.par_iter_mut().with_min_len(1 << 14).for_each(|v| *v *= factor);
            }
            B::tensor(values, &shape, &device)
        })
    }
}

/// The loss by the CPU's kernels, wherever the tensor lives.
pub(super) mod on_host {
    use super::*;

    pub fn loss<B: HostBackend>(
        image: FloatTensor<B>,
        photo: &Compared,
        ssim_weight: f64,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, photo) = (device_of::<B>(&image), photo.prepared());
        let (height, width) = photo.size();
        let shape = [height, width, CHANNELS];
        if image.dtype() == DType::F64 {
            let (loss, gradient) = photo
                .widened()
                .compare(&B::values::<f64>(image), ssim_weight);
            (
                B::tensor(vec![loss], &[1], &device),
                B::tensor(gradient, &shape, &device),
            )
        } else {
            let (loss, gradient) = photo.compare(&B::values::<f32>(image), ssim_weight);
            (
                B::tensor(vec![loss as f32], &[1], &device),
                B::tensor(gradient, &shape, &device),
            )
        }
    }
}

#[derive(Debug)]
struct PhotometricBackward;

impl<B: PhotometricBackend> Backward<B, 1> for PhotometricBackward {
    /// The gradient for an upstream gradient of 1.
    type State = FloatTensor<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let upstream = grads.consume::<B>(&ops.node);
        let [parent] = ops.parents;
        if let Some(node) = parent {
            grads.register::<B>(node.id, B::photometric_scale(ops.state, upstream));
        }
    }
}

impl<B: PhotometricBackend, C: CheckpointStrategy> PhotometricBackend for Autodiff<B, C> {
    fn photometric(
        image: FloatTensor<Self>,
        photo: Compared,
        ssim_weight: f64,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (image, node) = image.into_parts();
        let (loss, gradient) = B::photometric(image, photo, ssim_weight);
        let constant = <Self as burn::backend::AutodiffBackend>::from_inner(gradient.clone());
        let loss = match PhotometricBackward
            .prepare::<C>([node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => prep.finish(gradient, loss),
            OpsKind::UnTracked(prep) => prep.finish(loss),
        };
        (loss, constant)
    }

    fn photometric_scale(
        _gradient: FloatTensor<Self>,
        _factor: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        unimplemented!("second-order gradients")
    }
}

/// (1 - w) L1 + w (1 - SSIM) as a tensor `[1]`, with gradients to `image` (`[H, W, 3]`); equals
/// [`photometric_loss_plain`], of what no mask leaves out. `photo` is an [`std::sync::Arc`] of a [`super::Photo`] or of a
/// [`super::PackedPhoto`].
///
/// # Panics
/// If `image` has another size than `photo`.
pub fn photometric_loss(
    image: Tensor<3>,
    photo: impl Into<Compared>,
    ssim_weight: f64,
) -> Tensor<1> {
    let photo = photo.into();
    let (height, width) = photo.size();
    assert_eq!(
        image.dims(),
        [height, width, CHANNELS],
        "photometric loss: image against photo"
    );
    let (loss, _gradient) = Dispatch::photometric(image.into_dispatch(), photo, ssim_weight);
    Tensor::from_dispatch(loss)
}

/// The same loss in plain tensor operations: the reference of [`photometric_loss`]. `photo` is `[H, W, 3]`.
pub fn photometric_loss_plain(image: Tensor<3>, photo: Tensor<3>, ssim_weight: f64) -> Tensor<1> {
    let device = image.device();
    let line = taps::<f64>();
    let window: Vec<f64> = (0..CHANNELS * TAPS * TAPS)
        .map(|i| line[i / TAPS % TAPS] * line[i % TAPS])
        .collect();
    let window = Tensor::<4>::from_data(
        TensorData::new(window, [CHANNELS, 1, TAPS, TAPS]),
        (&device, image.dtype()),
    );
    let blur = |x: Tensor<4>| {
        conv2d(
            x,
            window.clone(),
            None,
            ConvOptions::new([1, 1], [RADIUS, RADIUS], [1, 1], CHANNELS),
        )
    };
    let planes = |x: Tensor<3>| x.permute([2, 0, 1]).unsqueeze::<4>();
    let l1 = (image.clone() - photo.clone()).abs().mean();
    let (x, y) = (planes(image), planes(photo));
    let (mx, my) = (blur(x.clone()), blur(y.clone()));
    let sxx = blur(x.clone() * x.clone()) - mx.clone() * mx.clone();
    let syy = blur(y.clone() * y.clone()) - my.clone() * my.clone();
    let sxy = blur(x * y) - mx.clone() * my.clone();
    let above = (mx.clone() * my.clone() * 2.0 + C1) * (sxy * 2.0 + C2);
    let below = (mx.clone() * mx + my.clone() * my + C1) * (sxx + syy + C2);
    let ssim = (above / below).mean();
    l1 * (1.0 - ssim_weight) + (ssim * -1.0 + 1.0) * ssim_weight
}
