//! The photometric loss of 3DGS, `(1 - w) L1 + w (1 - SSIM)` between a rendered image and a photo, fused with its gradient.
//!
//! SSIM has the constants of 3DGS: an 11x11 Gaussian window of sigma 1.5 with zero padding, `C1 = 0.01^2`, `C2 = 0.03^2`,
//! population covariance, and the mean over pixels and channels. With
//! `S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2))`, where every moment is a convolution with the
//! symmetric window `G`, the gradient is `dS/dx = G * dS/dmx + 2 x (G * dS/dxx) + y (G * dS/dxy)`.

mod cpu;
#[cfg(feature = "cube")]
mod gpu;
#[cfg(not(feature = "cube"))]
mod gpu {
    pub(super) type PhotoWords = ();
}

use crate::backend::device::in_host_memory;
use crate::backend::{Real, Resident, custom_op};
use crate::data::mask::Mask;
use crate::ops::CustomOp;
use burn::backend::{Dispatch, tensor::FloatTensor};
use burn::tensor::module::conv2d;
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Bool, Device, Tensor, TensorData};
use image::RgbImage;
use std::sync::{Arc, OnceLock};

/// Colour channels, interleaved.
const CHANNELS: usize = 3;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Taps of the window on either side of its centre.
const RADIUS: usize = 5;
/// Taps of the window.
const TAPS: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;

/// Normalised taps of the window along one axis. The window is their outer product.
fn taps<E: Real>() -> [E; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|k| {
        (-(k as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA * SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| E::of(w / sum))
}

/// A photo that renders are compared with: 8-bit pixels, and which of them count.
///
/// The CPU keeps the values and their windowed moments after the first comparison. A GPU keeps the bytes, a thirteenth of that,
/// and computes the moments in each comparison.
#[derive(Debug)]
pub struct PhotometricTarget {
    pixels: Arc<RgbImage>,
    mask: Option<Mask>,
    moments: OnceLock<cpu::Moments<f32>>,
    #[cfg_attr(
        not(feature = "cube"),
        allow(dead_code, reason = "only a GPU reads it")
    )]
    words: Resident<gpu::PhotoWords>,
}

impl PhotometricTarget {
    /// A target with these pixels. Pixels outside the mask count for nothing: they are black in the photo and in each render,
    /// and their gradient is exactly zero.
    ///
    /// # Panics
    /// If the mask has a different size than the photo.
    pub fn new(mut pixels: Arc<RgbImage>, mask: Option<Mask>) -> Self {
        if let Some(mask) = &mask {
            let size = (pixels.width() as usize, pixels.height() as usize);
            assert_eq!(
                (mask.width(), mask.height()),
                size,
                "photometric target: mask against photo"
            );
            let pixels: &mut RgbImage = Arc::make_mut(&mut pixels);
            mask.fill(pixels, CHANNELS, 0);
        }
        Self {
            pixels,
            mask,
            moments: OnceLock::new(),
            words: Resident::default(),
        }
    }

    /// (height, width) in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.pixels.height() as usize, self.pixels.width() as usize)
    }

    /// Bytes that it holds on `device`; on a GPU as many in host memory.
    pub fn bytes(&self, device: &Device) -> usize {
        let (height, width) = self.size();
        let pixels = height * width;
        if in_host_memory(device) {
            pixels * CHANNELS * (1 + 3 * size_of::<f32>())
        } else {
            pixels * CHANNELS
        }
    }

    /// Bytes of targets to keep for `device`: on a GPU 345 photos of 1920x1080 pixels.
    pub fn budget(device: &Device) -> usize {
        if in_host_memory(device) {
            1 << 30
        } else {
            2 << 30
        }
    }

    /// `[H, W, 3]` values in 0..1, row-major.
    fn values<E: Real>(&self) -> Vec<E> {
        let bytes = self.pixels.as_raw().iter();
        bytes
            .map(|&v| E::of(f64::from(f32::from(v) / 255.0)))
            .collect()
    }

    /// `image`, `[H, W, 3]`, black where pixels do not count.
    fn masked(&self, image: Tensor<3>) -> Tensor<3> {
        let Some(mask) = &self.mask else { return image };
        let hidden = (0..mask.width() * mask.height()).map(|pixel| !mask.uses(pixel));
        let shape = [mask.height(), mask.width(), 1];
        let data = TensorData::new(hidden.collect::<Vec<bool>>(), shape);
        let hidden = Tensor::<3, Bool>::from_data(data, &image.device());
        let shape = image.dims();
        image.mask_fill(hidden.expand(shape), 0.0)
    }
}

custom_op! {
    /// Backend side of [`photometric_loss`].
    pub(crate) trait PhotometricBackend {
        /// The loss `[1]` and its gradient to the image, `[H, W, 3]`. The mask is ignored.
        fn loss_and_gradient(
            image: FloatTensor<Self>,
            target: Arc<PhotometricTarget>,
            ssim_weight: f64,
        ) -> (FloatTensor<Self>, FloatTensor<Self>);
    }
    backward {}
}

mod autodiff {
    use super::{PhotometricBackend, PhotometricTarget};
    use crate::backend::{AutodiffTensor, track};
    use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
    use burn::backend::{Autodiff, AutodiffBackend};
    use burn::tensor::Shape;
    use std::sync::Arc;

    /// The loss has a gradient to the image; the gradient itself has none.
    pub fn loss_and_gradient<B: PhotometricBackend, C: CheckpointStrategy>(
        image: AutodiffTensor<B, C>,
        target: Arc<PhotometricTarget>,
        ssim_weight: f64,
    ) -> (AutodiffTensor<B, C>, AutodiffTensor<B, C>) {
        let plain = Autodiff::<B, C>::inner(image.clone());
        let (loss, gradient) = B::loss_and_gradient(plain, target, ssim_weight);
        let of_image = gradient.clone();
        let loss = track::<B, C, 1, _>([image], |_| {
            let backward = move |upstream, _wanted| {
                let upstream = B::float_reshape(upstream, Shape::new([1; 3]));
                [Some(B::float_mul(of_image, upstream))]
            };
            (loss, backward)
        });
        (loss, Autodiff::<B, C>::from_inner(gradient))
    }
}

/// `(1 - w) L1 + w (1 - SSIM)` as a tensor `[1]`, with a gradient to `image` (`[H, W, 3]`); equals
/// [`photometric_loss_plain`].
///
/// # Panics
/// If `image` has a different size than `target`.
pub fn photometric_loss(
    image: Tensor<3>,
    target: &Arc<PhotometricTarget>,
    ssim_weight: f64,
) -> Tensor<1> {
    let (height, width) = target.size();
    assert_eq!(
        image.dims(),
        [height, width, CHANNELS],
        "photometric loss: image against photo"
    );
    if CustomOp::Photometric.is_replaced() {
        return photometric_loss_plain(image, target, ssim_weight);
    }
    let image = target.masked(image).into_dispatch();
    let (loss, _) = Dispatch::loss_and_gradient(image, target.clone(), ssim_weight);
    Tensor::from_dispatch(loss)
}

/// The same loss in plain tensor operations: the reference of [`photometric_loss`].
pub fn photometric_loss_plain(
    image: Tensor<3>,
    target: &PhotometricTarget,
    ssim_weight: f64,
) -> Tensor<1> {
    let device = image.device();
    let options = (&device, image.dtype());
    let line = taps::<f64>();
    let window: Vec<f64> = (0..CHANNELS * TAPS * TAPS)
        .map(|i| line[i / TAPS % TAPS] * line[i % TAPS])
        .collect();
    let window = TensorData::new(window, [CHANNELS, 1, TAPS, TAPS]);
    let window = Tensor::<4>::from_data(window, options);
    let blur = |x: Tensor<4>| {
        let padded = ConvOptions::new([1, 1], [RADIUS, RADIUS], [1, 1], CHANNELS);
        conv2d(x, window.clone(), None, padded)
    };
    let image = target.masked(image);
    let photo = TensorData::new(target.values::<f64>(), image.dims());
    let photo = Tensor::<3>::from_data(photo, options);
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
