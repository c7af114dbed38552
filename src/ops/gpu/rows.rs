//! Rows picked on the device, a unit a scalar: for densification, and for what gathers rows with a gradient.

use super::covers;
use crate::backend::gpu::{Gpu, arg};
use crate::ops::rows::{RowBackend, RowMap, StartOfNew, on_host};
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::{DType, FloatDType};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use std::sync::Arc;

/// `out[r] = x[sources[r]]`, zeros for new members where `zero`.
#[cube(launch)]
pub(super) fn pick(
    x: &[f32],
    sources: &[u32],
    out: &mut [f32],
    count: u32,
    width: u32,
    #[comptime] zero: bool,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let source = sources[i / width as usize];
    let row = (source & comptime![!RowMap::NEW]) as usize;
    let mut value = x[row * width as usize + i % width as usize];
    if comptime![zero] {
        value = select(source >= comptime![RowMap::NEW], 0.0f32, value);
    }
    out[i] = value;
}

impl RowBackend for CubeBackend {
    fn take_rows(x: FloatTensor<Self>, map: Arc<RowMap>, new: StartOfNew) -> FloatTensor<Self> {
        let mut shape = x.meta.shape().to_vec();
        let width: usize = shape[1..].iter().product();
        let count = map.len() * width;
        shape[0] = map.len();
        if !covers(&x) {
            return on_host::take_rows::<Self>(x, &map, new);
        }
        let gpu = Gpu::of(&x);
        if count == 0 {
            return Self::float_zeros(shape.into(), gpu.device(), FloatDType::F32);
        }
        let sources = map
            .resident
            .on(&gpu, || gpu.upload(&map.sources, DType::U32));
        let out = gpu.floats(shape);
        pick::launch(
            &gpu.client,
            gpu.cubes_for(count),
            gpu.dim(),
            arg(&into_contiguous(x)),
            arg(&sources),
            arg(&out),
            count as u32,
            width as u32,
            new == StartOfNew::Zero,
        );
        out
    }
}
