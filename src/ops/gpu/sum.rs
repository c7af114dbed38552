//! Sums in a fixed order: the same bits every time.

use crate::gpu::{Gpu, UNITS, arg};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

const GROUP: usize = 16;
/// Consecutive reads under way at a time.
const READS: usize = 8;

/// The sum of `value` over the units of the cube, known to the first one. All of them call it.
#[cube]
pub(super) fn sum_cube(value: f32) -> f32 {
    let unit = UNIT_POS as usize;
    let mut values = Shared::<[f32]>::new_slice(UNITS as usize);
    let mut groups = Shared::<[f32]>::new_slice(GROUP);
    values[unit] = value;
    sync_cube();
    // Two levels of 16 serial sums need fewer barriers than a tree.
    if unit < GROUP {
        let mut sum = 0.0f32;
        for k in 0..GROUP {
            sum += values[unit * GROUP + k];
        }
        groups[unit] = sum;
    }
    sync_cube();
    let mut total = 0.0f32;
    if unit == 0 {
        for k in 0..GROUP {
            total += groups[k];
        }
    }
    total
}

/// The sum of `count` values, by one cube.
#[cube(launch)]
fn sum_all(values: &[f32], total: &mut [f32], count: u32) {
    if CUBE_POS >= 1 {
        terminate!();
    }
    let mut sum = 0.0f32;
    let mut at = UNIT_POS as usize;
    while at < count as usize {
        let mut part = 0.0f32;
        #[unroll]
        for k in 0..READS {
            if at + k * (UNITS as usize) < count as usize {
                part += values[at + k * (UNITS as usize)];
            }
        }
        sum += part;
        at += READS * UNITS as usize;
    }
    let all = sum_cube(sum);
    if UNIT_POS == 0 {
        total[0] = all;
    }
}

/// The sum of the first `count` of `values`, `[1]`.
pub(super) fn sum(gpu: &Gpu, values: &CubeTensor, count: usize) -> CubeTensor {
    let total = gpu.floats([1]);
    sum_all::launch(&gpu.client, gpu.cubes(1), gpu.dim(), arg(values), arg(&total), count as u32);
    total
}
