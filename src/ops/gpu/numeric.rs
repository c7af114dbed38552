//! Elementary functions that keep their digits near 0, where WGSL offers none.

use burn_cubecl::cubecl::{self, prelude::*};

/// Below this the series are taken. Devices may take `log` near 1 with an error of 2^-21 (WGSL): above it that is 2e-6 of the result.
const SMALL: f32 = 0.25;

/// ln(1 + x) for x > -1.
#[cube]
pub(super) fn ln_1p(x: f32) -> f32 {
    let mut value = (1.0f32 + x).ln();
    if x.abs() < SMALL {
        // 2 artanh(x / (2 + x)); the first term left out is 2e-8 of the result
        let s = x / (2.0f32 + x);
        let q = s * s;
        value =
            2.0f32 * s * (1.0f32 + q * (1.0f32 / 3.0f32 + q * (0.2f32 + q * (1.0f32 / 7.0f32))));
    }
    value
}

/// exp(x) - 1 for x <= 0.
#[cube]
pub(super) fn exp_m1_nonpositive(x: f32) -> f32 {
    let mut value = x.exp() - 1.0f32;
    if x > -SMALL {
        // the first term left out is 2e-9 of the result
        let more = 1.0f32 / 24.0f32
            + x * (1.0f32 / 120.0f32 + x * (1.0f32 / 720.0f32 + x * (1.0f32 / 5040.0f32)));
        value = x * (1.0f32 + x * (0.5f32 + x * (1.0f32 / 6.0f32 + x * more)));
    }
    value
}
