//! Sums in a fixed order, which give the same bits every time.

use super::UNITS;
use burn_cubecl::cubecl::{self, prelude::*};

const GROUP: usize = 16;

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
