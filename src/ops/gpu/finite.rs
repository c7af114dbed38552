//! Non-finite values counted on the device, and the count beside a loss.

use crate::gpu::{Gpu, add_non_finite, arg};
use crate::ops::finite::FiniteBackend;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::{cast, into_contiguous};

#[cube(launch)]
fn beside(loss: &[f32], count: &[u32], both: &mut [f32]) {
    if ABSOLUTE_POS == 0 {
        both[0] = loss[0];
        both[1] = f32::cast_from(count[0]);
    }
}

impl FiniteBackend for CubeBackend {
    fn add_non_finite(count: IntTensor<Self>, values: FloatTensor<Self>) -> IntTensor<Self> {
        let gpu = Gpu::of(&values);
        let values = into_contiguous(cast(values, DType::F32));
        let count = cast(count, DType::U32);
        let count = if count.can_mut() { count } else { count.copy() };
        add_non_finite(&gpu, &values, values.meta.num_elements(), &count);
        count
    }

    fn with_count(loss: FloatTensor<Self>, count: IntTensor<Self>) -> FloatTensor<Self> {
        let gpu = Gpu::of(&loss);
        let both = gpu.floats([2]);
        let (loss, count) = (into_contiguous(cast(loss, DType::F32)), cast(count, DType::U32));
        beside::launch(&gpu.client, gpu.cubes(1), gpu.dim(), arg(&loss), arg(&count), arg(&both));
        both
    }
}
