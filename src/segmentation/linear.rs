//! Linear layers: their random initial weights, maps of many rows, computed in blocks of rows, and LeakyReLU.
//!
//! The gradients of a weight and of a bias are sums over all rows. A GPU computes such a product, of few outputs and a long sum,
//! within one workgroup. With blocks, each has a workgroup, and their sums are added up.

use crate::backend::device::upload;
use crate::random::uniform;
use burn::module::Param;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};
use rand_chacha::ChaCha8Rng;

/// Rows of a block.
pub const BLOCK: usize = 256;
/// Slope of LeakyReLU below zero.
const SLOPE: f64 = 0.2;

/// LeakyReLU with slope 0.2. The slope is detached, so that the backward pass is one product: burn's own selects by masks, twice.
pub(super) fn leaky_relu(x: Tensor<2>) -> Tensor<2> {
    let slope = x.clone().detach().sign() * (0.5 * (1.0 - SLOPE)) + 0.5 * (1.0 + SLOPE);
    x * slope
}

/// A parameter with `values` on `device`.
pub(crate) fn parameter<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Param<Tensor<D>> {
    Param::from_tensor(upload(values, shape, device))
}

/// The initial weights of a layer are uniform in +- this, 1 / sqrt(`inputs`).
pub(super) fn bound(inputs: usize) -> f32 {
    1.0 / (inputs.max(1) as f32).sqrt()
}

/// A linear map of `inputs` to `outputs` channels with random initial weights.
pub(crate) fn linear(
    inputs: usize,
    outputs: usize,
    rng: &mut ChaCha8Rng,
    device: &Device,
) -> Linear {
    let bound = bound(inputs);
    let weight = uniform(inputs * outputs, bound, rng);
    let bias = uniform(outputs, bound, rng);
    Linear {
        weight: parameter(weight, [inputs, outputs], device),
        bias: Some(parameter(bias, [outputs], device)),
    }
}

/// Repeats the last row until the rows fill whole blocks. One block or less stays as it is.
pub fn fill_blocks(rows: &mut Vec<u32>) {
    if let Some(&last) = rows.last()
        && rows.len() > BLOCK
    {
        rows.resize(rows.len().next_multiple_of(BLOCK), last);
    }
}

/// `x W`, `[N, M]`, of `x` `[N, K]` and `weight` `[K, M]`. In blocks if N is a multiple of [`BLOCK`] and larger.
pub fn product(x: Tensor<2>, weight: Tensor<2>) -> Tensor<2> {
    let [rows, inputs] = x.dims();
    let outputs = weight.dims()[1];
    if !is_in_blocks(rows) {
        return x.matmul(weight);
    }
    let blocks = x.reshape([rows / BLOCK, BLOCK, inputs]);
    blocks.matmul(weight.unsqueeze()).reshape([rows, outputs])
}

/// `x + bias`, `[N, M]`, of `x` `[N, M]` and `bias` `[M]`. In blocks if N is a multiple of [`BLOCK`] and larger.
pub fn add_bias(x: Tensor<2>, bias: Tensor<1>) -> Tensor<2> {
    let [rows, outputs] = x.dims();
    if !is_in_blocks(rows) {
        return x + bias.unsqueeze();
    }
    let blocks = x.reshape([rows / BLOCK, BLOCK, outputs]);
    // Copies for the blocks: the backward pass sums within each, then over all. burn would merge the two sums of one broadcast.
    let copies = bias.reshape([1, 1, outputs]);
    let copies = copies.expand([rows / BLOCK, 1, outputs]);
    (blocks + copies).reshape([rows, outputs])
}

fn is_in_blocks(rows: usize) -> bool {
    rows > BLOCK && rows.is_multiple_of(BLOCK)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device;
    use burn::tensor::{DType, TensorData};

    #[test]
    fn rows_fill_blocks() {
        let filled = |count: u32| {
            let mut rows: Vec<u32> = (0..count).collect();
            fill_blocks(&mut rows);
            rows
        };
        assert!(filled(0).is_empty());
        assert_eq!(filled(256).len(), 256);
        let rows = filled(300);
        assert_eq!((rows.len(), rows[299], rows[511]), (512, 299, 299));
    }

    #[test]
    fn blocks_change_neither_values_nor_gradients() {
        let device = device::open(None).expect("a device").autodiff();
        let waves = |rows: usize, columns: usize, phase: f64| {
            let values = (0..rows * columns).map(|i| (i as f64 * 0.7 + phase).sin());
            let data = TensorData::new(values.collect::<Vec<_>>(), [rows, columns]);
            Tensor::<2>::from_data(data, (&device, DType::F32)).require_grad()
        };
        let (x, w, g) = (waves(768, 5, 0.1), waves(5, 7, 0.2), waves(768, 7, 0.3));
        let b = waves(1, 7, 0.4);
        let of = |y: Tensor<2>| {
            let gradients = (y.clone() * g.clone()).sum().backward();
            let parts = [&x, &w, &b].map(|t| t.grad(&gradients).expect("a gradient"));
            [y.inner()].into_iter().chain(parts)
        };
        let bias = b.clone().reshape([7]);
        let in_blocks = of(add_bias(product(x.clone(), w.clone()), bias));
        let at_once = of(x.clone().matmul(w.clone()) + b.clone());
        for (got, want) in in_blocks.zip(at_once) {
            let scale = want.clone().abs().max().into_scalar::<f32>();
            let worst = (got - want).abs().max().into_scalar::<f32>();
            assert!(worst < 1e-5 * scale, "{worst} of {scale}");
        }
    }
}
