//! Values that are NaN or infinite, counted.

use super::{Gpu, launch};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Whether `x` is neither a NaN nor an infinity: by its bits, because WGSL compilers may assume that there are none.
#[cube]
pub fn is_finite(x: f32) -> bool {
    (u32::reinterpret(x) & 0x7f80_0000u32) != 0x7f80_0000u32
}

#[cube(launch)]
fn count_non_finite(values: &[f32], report: &[Atomic<u32>], count: u32) {
    let stride = CUBE_COUNT * CUBE_DIM as usize;
    let mut i = ABSOLUTE_POS;
    while i < count as usize {
        if !is_finite(values[i]) {
            report[0].fetch_add(1u32);
        }
        i += stride;
    }
}

/// Adds the number of non-finite `values` to `report[0]`, a 32-bit integer.
pub fn add_non_finite(gpu: &Gpu, values: &CubeTensor, report: &CubeTensor) {
    let len = values.meta.num_elements();
    if len > 0 {
        // A unit looks at several values.
        let units = len.min(1 << 20);
        launch!(gpu, count_non_finite, gpu.cubes_for(units);
            values, report; len as u32);
    }
}
