//! Constants of one view as the kernels read them.

use crate::raster::Settings;
use crate::raster::cpu::geometry::Viewpoint;

/// Rows of the world-to-camera rotation, nine numbers.
pub(super) const AXES: usize = 0;
/// Camera centre rounded to f32, and the rounding error: the difference to a mean keeps its digits.
pub(super) const CENTER: usize = 9;
pub(super) const CENTER_REST: usize = 12;
/// `fx fy`, `cx cy`, pixels.
pub(super) const FOCAL: usize = 15;
pub(super) const PRINCIPAL: usize = 17;
/// Lowest and highest x/z, then y/z, that the Jacobian is taken at.
pub(super) const LIMITS: usize = 19;
/// Image width and height, pixels.
pub(super) const SIZE: usize = 23;
pub(super) const NEAR: usize = 25;
pub(super) const LOW_PASS: usize = 26;
pub(super) const ALPHA_MIN: usize = 27;
/// Natural logarithm of alpha_min.
pub(super) const LN_ALPHA_MIN: usize = 28;
pub(super) const ALPHA_MAX: usize = 29;
pub(super) const T_MIN: usize = 30;
pub(super) const BACKGROUND: usize = 31;
const LEN: usize = 34;

/// The numbers at the offsets above.
pub(super) fn constants(view: &Viewpoint, settings: &Settings, background: [f64; 3]) -> [f32; LEN] {
    let mut out = [0.0; LEN];
    let mut put = |at: usize, values: &[f64]| {
        for (out, &v) in out[at..].iter_mut().zip(values) {
            *out = v as f32;
        }
    };
    put(AXES, view.axes.as_flattened());
    put(CENTER, &view.center);
    put(CENTER_REST, &view.center.map(|c| c - f64::from(c as f32)));
    put(FOCAL, &view.focal);
    put(PRINCIPAL, &view.principal);
    put(LIMITS, view.limits.as_flattened());
    put(SIZE, &view.size.map(|edge| edge as f64));
    put(NEAR, &[settings.near]);
    put(LOW_PASS, &[settings.low_pass]);
    put(ALPHA_MIN, &[settings.alpha_min]);
    put(LN_ALPHA_MIN, &[settings.alpha_min.ln()]);
    put(ALPHA_MAX, &[settings.alpha_max]);
    put(T_MIN, &[settings.t_min]);
    put(BACKGROUND, &background);
    out
}
