//! Products of tall matrices with small ones: burn's forward, where many rows keep a device busy, and a kernel for the gradient of the
//! weights, a sum over all rows.

mod weights;

pub(super) use self::weights::weights_gradient;

use crate::backend::gpu::Gpu;
use crate::ops::dense::DenseBackend;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::FloatDType;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;

/// Zeros.
pub(super) fn zeros(gpu: &Gpu, shape: [usize; 2]) -> CubeTensor {
    CubeBackend::float_zeros(shape.into(), gpu.device(), FloatDType::F32)
}

impl DenseBackend for CubeBackend {
    fn dense(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let (gpu, count, width) = (Gpu::of(&x), x.meta.shape()[0], weight.meta.shape()[1]);
        if count * width == 0 {
            return zeros(&gpu, [count, width]);
        }
        let with_bias = bias.meta.num_elements() > 0;
        let product = match x.meta.shape()[1] {
            0 => zeros(&gpu, [count, width]),
            _ => Self::float_matmul(x, weight),
        };
        match with_bias {
            true => Self::float_add(product, Self::float_reshape(bias, [1, width].into())),
            false => product,
        }
    }

    fn dense_inputs_gradient(g: FloatTensor<Self>, weight: FloatTensor<Self>) -> FloatTensor<Self> {
        let (count, inputs) = (g.meta.shape()[0], weight.meta.shape()[0]);
        match count * inputs * g.meta.shape()[1] {
            0 => zeros(&Gpu::of(&g), [count, inputs]),
            _ => Self::float_matmul(g, Self::float_transpose(weight)),
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
