//! The photometric loss and its gradient in f64.

use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::data::mask::Mask;
use coseg::ops::{PhotometricTarget, photometric_loss};
use std::sync::Arc;

/// `bytes`, three a pixel, as a target.
pub fn target_of(
    bytes: Vec<u8>,
    size: (usize, usize),
    mask: Option<Mask>,
) -> Arc<PhotometricTarget> {
    let (height, width) = size;
    let pixels =
        image::RgbImage::from_raw(width as u32, height as u32, bytes).expect("as many bytes");
    Arc::new(PhotometricTarget::new(Arc::new(pixels), mask))
}

/// `values` in 8 bits as a target.
pub fn target(values: &[f64], size: (usize, usize), mask: Option<Mask>) -> Arc<PhotometricTarget> {
    let bytes = values.iter().map(|v| (v * 255.0).round() as u8).collect();
    target_of(bytes, size, mask)
}

/// A loss of an image `[H, W, 3]`.
pub type Loss<'a> = &'a dyn Fn(Tensor<3>) -> Tensor<1>;

/// `factor` times the loss of `image`, and its gradient.
pub fn run(
    loss: Loss<'_>,
    image: &[f64],
    (height, width): (usize, usize),
    factor: f64,
    options: (&Device, DType),
) -> (f64, Vec<f64>) {
    let data = TensorData::new(image.to_vec(), [height, width, 3]);
    let leaf = Tensor::<3>::from_data(data, options).require_grad();
    let loss = loss(leaf.clone());
    assert_eq!(loss.dims(), [1]);
    let gradient = leaf
        .grad(&(loss.clone() * factor).backward())
        .expect("tracked");
    assert_eq!(gradient.dims(), [height, width, 3]);
    let gradient = gradient.into_data().convert::<f64>().into_vec();
    (
        loss.into_data()
            .convert::<f64>()
            .into_vec::<f64>()
            .expect("one")[0],
        gradient.expect("f64"),
    )
}

/// Loss and gradient of `image` on the CPU in f64.
pub fn compare(target: &Arc<PhotometricTarget>, image: &[f64], weight: f64) -> (f64, Vec<f64>) {
    let device = crate::support::device().autodiff();
    let loss = |image| photometric_loss(image, target, weight);
    run(&loss, image, target.size(), 1.0, (&device, DType::F64))
}
