//! Products of tall matrices with small ones: a map of rows, and both of its adjoints.
//!
//! Units of a cube stand in a square, and each keeps a few rows and columns of the cube's tile of the result in registers;
//! what is summed over passes through shared memory a stretch at a time.

mod product;
mod weights;

pub(super) use product::{Below, Product, inputs_gradient};
pub(super) use weights::weights_gradient;

use crate::gpu::Gpu;
use crate::ops::dense::DenseBackend;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::FloatDType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// Units along either side of a cube's square.
const SIDE: usize = 16;
/// Rows of a tile that a unit keeps, and most of its columns.
const OWN: usize = 4;
/// Rows of a tile.
const TILE: usize = SIDE * OWN;
/// What is in shared memory at a time of the dimension that is summed over.
const DEPTH: usize = SIDE;

/// `[rows, inputs]` by `[inputs, width]`.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
struct Sizes {
    rows: u32,
    inputs: u32,
    width: u32,
}

/// `tensor` in order; a binding cannot be empty.
fn whole(gpu: &Gpu, tensor: &CubeTensor) -> CubeTensor {
    if tensor.meta.num_elements() == 0 { gpu.floats([1]) } else { into_contiguous(tensor.clone()) }
}

/// Columns of a tile that a unit keeps, of a result `width` wide.
fn each(width: usize) -> usize {
    width.div_ceil(SIDE).next_power_of_two().min(OWN)
}

/// Whether the device of `tensor` binds as many buffers as a product does, with that of its sizes.
pub(super) fn binds_a_product(tensor: &CubeTensor) -> bool {
    tensor.client.properties().hardware.max_bindings >= 10
}

/// Zeros.
pub(super) fn zeros(gpu: &Gpu, shape: [usize; 2]) -> CubeTensor {
    CubeBackend::float_zeros(shape.into(), gpu.device(), FloatDType::F32)
}

impl DenseBackend for CubeBackend {
    fn dense(x: FloatTensor<Self>, weight: FloatTensor<Self>, bias: FloatTensor<Self>) -> FloatTensor<Self> {
        let (gpu, count, width) = (Gpu::of(&x), x.meta.shape()[0], weight.meta.shape()[1]);
        if count * width == 0 {
            return zeros(&gpu, [count, width]);
        }
        let with_bias = bias.meta.num_elements() > 0;
        if !binds_a_product(&x) {
            let product = Self::float_matmul(x, weight);
            return match with_bias {
                true => Self::float_add(product, Self::float_reshape(bias, [1, width].into())),
                false => product,
            };
        }
        let bias = with_bias.then_some(&bias);
        Product { x: &x, rows: None, weight: &weight, bias, below: None }.run(&gpu, count)
    }

    fn dense_inputs_gradient(g: FloatTensor<Self>, weight: FloatTensor<Self>) -> FloatTensor<Self> {
        let (gpu, count, inputs) = (Gpu::of(&g), g.meta.shape()[0], weight.meta.shape()[0]);
        match count * inputs {
            0 => zeros(&gpu, [count, inputs]),
            _ if !binds_a_product(&g) => Self::float_matmul(g, Self::float_transpose(weight)),
            _ => inputs_gradient(&gpu, &g, &weight, None),
        }
    }

    fn dense_weights_gradient(
        x: FloatTensor<Self>,
        g: FloatTensor<Self>,
        with_bias: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        weights_gradient(&Gpu::of(&g), &x, None, &g, with_bias)
    }
}
