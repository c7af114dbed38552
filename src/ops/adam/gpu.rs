//! The Adam step in one kernel, one unit for each scalar.

use super::{AdamStep, EPSILON, Updated, cpu};
use crate::backend::gpu::{Gpu, launch};
use crate::ops::gpu::{covers, own};
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use std::sync::Arc;

/// `rate` holds for all scalars, or `rates` repeats along them where `period` is above 1.
#[cube(launch)]
fn adam(
    param: &mut [f32],
    gradient: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    rates: &[f32],
    count: u32,
    rate: f32,
    beta1: f32,
    rest1: f32,
    beta2: f32,
    rest2: f32,
    root: f32,
    epsilon: f32,
    #[comptime] period: usize,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let g = gradient[i];
    let m = beta1 * first[i] + rest1 * g;
    let v = beta2 * second[i] + rest2 * (g * g);
    first[i] = m;
    second[i] = v;
    let mut by = rate;
    if comptime![period > 1] {
        by = rates[i % period];
    }
    param[i] -= by * m / (v.sqrt() * root + epsilon);
}

/// The step on a GPU; tensors that are not f32 take the kernel for CPUs.
pub fn adam_step(
    param: FloatTensor<CubeBackend>,
    grad: FloatTensor<CubeBackend>,
    first: FloatTensor<CubeBackend>,
    second: FloatTensor<CubeBackend>,
    step: Arc<AdamStep>,
) -> Updated<CubeBackend> {
    let count = param.meta.num_elements();
    if !covers(&param) || count == 0 {
        return cpu::adam_step::<CubeBackend>(param, grad, first, second, step);
    }
    let gpu = Gpu::of(&param);
    let param = own(param);
    let first = own(first);
    let second = own(second);
    let (c1, c2) = step.corrections();
    let [beta1, beta2] = step.betas();
    let rates: Vec<f32> = step.rates.iter().map(|rate| (rate / c1) as f32).collect();
    let rate = rates.first().copied().unwrap_or_default();
    // One rate for all travels with the launch.
    let rates = if rates.len() > 1 {
        gpu.upload(&rates)
    } else {
        gpu.floats([1])
    };
    launch!(gpu, adam, gpu.cubes_for(count);
        &param, &into_contiguous(grad), &first, &second, &rates;
        count as u32, rate, beta1 as f32, (1.0 - beta1) as f32, beta2 as f32, (1.0 - beta2) as f32,
        (1.0 / c2.sqrt()) as f32, EPSILON as f32, step.rates.len());
    (param, first, second)
}
