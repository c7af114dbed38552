//! Non-finite values counted on the device, and the count beside a loss.

use crate::backend::gpu::{Gpu, add_non_finite, arg};
use crate::ops::finite::FiniteBackend;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::{cast, into_contiguous};

#[cube(launch)]
fn beside(loss: &[f32], count: &[u32], others: &[f32], all: &mut [f32], length: u32) {
    if ABSOLUTE_POS == 0 {
        all[0] = loss[0];
        all[1] = f32::cast_from(count[0]);
    }
    if ABSOLUTE_POS < length as usize {
        all[2 + ABSOLUTE_POS] = others[ABSOLUTE_POS];
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

    fn with_count(
        loss: FloatTensor<Self>,
        count: IntTensor<Self>,
        others: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let gpu = Gpu::of(&loss);
        let length = others.meta.num_elements();
        let all = gpu.floats([2 + length]);
        let [loss, others] = [loss, others].map(|tensor| into_contiguous(cast(tensor, DType::F32)));
        // A binding cannot be empty.
        let others = if length > 0 { others } else { loss.clone() };
        let (count, cubes) = (cast(count, DType::U32), gpu.cubes_for(length.max(1)));
        beside::launch(
            &gpu.client,
            cubes,
            gpu.dim(),
            arg(&loss),
            arg(&count),
            arg(&others),
            arg(&all),
            length as u32,
        );
        all
    }
}
