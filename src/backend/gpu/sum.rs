//! Sums in a fixed order, which give the same bits every time.

use super::{Gpu, UNITS, arg};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

const GROUP: usize = 16;
/// Reads of a unit in flight at a time.
const READS: usize = 8;
/// Values that one cube sums before several cubes share the work.
const STRETCH: usize = 4 * READS * UNITS as usize;

/// The sum of `value` over the units of the cube, known to the first unit. All units call it.
#[cube]
pub fn sum_cube(value: f32) -> f32 {
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

/// The sum of each `stretch` of `count` values, by one cube.
#[cube(launch)]
fn sum_stretches(values: &[f32], totals: &mut [f32], count: u32, stretch: u32) {
    let first = CUBE_POS * stretch as usize;
    if first >= count as usize {
        terminate!();
    }
    let end = min(first + stretch as usize, count as usize);
    let mut sum = 0.0f32;
    let mut at = first + UNIT_POS as usize;
    while at < end {
        let mut part = 0.0f32;
        #[unroll]
        for k in 0..READS {
            if at + k * (UNITS as usize) < end {
                part += values[at + k * (UNITS as usize)];
            }
        }
        sum += part;
        at += READS * UNITS as usize;
    }
    let all = sum_cube(sum);
    if UNIT_POS == 0 {
        totals[CUBE_POS] = all;
    }
}

/// The sum `[1]` of the first `count` of `values`; `count` is at least 1.
pub fn sum(gpu: &Gpu, values: &CubeTensor, count: usize) -> CubeTensor {
    let sums_of = |values: &CubeTensor, count: usize, stretch: usize| {
        let cubes = count.div_ceil(stretch);
        let totals = gpu.floats([cubes]);
        let (from, to) = (arg(values), arg(&totals));
        sum_stretches::launch(
            &gpu.client,
            gpu.cubes(cubes),
            gpu.dim(),
            from,
            to,
            count as u32,
            stretch as u32,
        );
        totals
    };
    if count <= STRETCH {
        return sums_of(values, count, count);
    }
    let stretch = STRETCH.max(count.div_ceil(STRETCH));
    let parts = count.div_ceil(stretch);
    sums_of(&sums_of(values, count, stretch), parts, parts)
}
