//! Elementary functions that keep their digits near 0, where WGSL offers none.

use burn_cubecl::cubecl::{self, prelude::*};

/// Below this the series are taken: the first term left out is 1e-8 of the result.
const SMALL: f32 = 0.04;

/// ln(1 + x) for x > -1.
#[cube]
pub(super) fn ln_1p(x: f32) -> f32 {
    let mut value = (1.0f32 + x).ln();
    if x.abs() < SMALL {
        value =
            x * (1.0f32 - x * (0.5f32 - x * (1.0f32 / 3.0f32 - x * (0.25f32 - x * (0.2f32 - x * (1.0f32 / 6.0f32))))));
    }
    value
}

/// exp(x) - 1 for x <= 0.
#[cube]
pub(super) fn exp_m1_nonpositive(x: f32) -> f32 {
    let mut value = x.exp() - 1.0f32;
    if x > -SMALL {
        value = x * (1.0f32 + x * (0.5f32 + x * (1.0f32 / 6.0f32 + x * (1.0f32 / 24.0f32))));
    }
    value
}
