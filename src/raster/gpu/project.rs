//! Projection and culling: one unit for each Gaussian.

use super::ewa::{ewa, offset_from_camera, rows_cross, to_camera};
use super::inputs::Inputs;
use super::vec3::{dot, read3};
use super::view::{FOCAL, LN_ALPHA_MIN, LOW_PASS, NEAR, PRINCIPAL, SIZE};
use crate::backend::gpu::{Gpu, is_finite, launch};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Floats a projected Gaussian takes: centre x and y (pixels), slope `B / Y`, `du = 1 / sqrt(2 s2)`,
/// `dv = 1 / sqrt(2 Y)`, ln(opacity), reach (largest `sqrt(u^2 + v^2)` that contributes, with a margin), depth.
pub(super) const SPLAT: usize = 8;
/// Depth key of a culled Gaussian: above that of every finite depth.
const CULLED: u32 = 0xffff_ffff;
/// Smallest normal f32.
const NORMAL: f32 = 1.175_494_4e-38;

/// `a / b`, corrected by what is left of `a` where `fma` is fused: WGSL and SPIR-V allow a division to be off by 2.5 units in the
/// last place, which matters for a small Gaussian near the edge of a wide image.
#[cube]
fn quotient(a: f32, b: f32) -> f32 {
    let q = a / b;
    q + fma(-q, b, a) / b
}

#[cube(launch)]
fn project_kernel(
    means: &[f32],
    log_scales: &[f32],
    rotations: &[f32],
    logits: &[f32],
    view: &[f32],
    splats: &mut [f32],
    depths: &mut [u32],
    radii: &mut [u32],
    report: &[Atomic<u32>],
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    depths[i] = CULLED;
    radii[i] = 0u32;
    let mean = read3(means, 3 * i);
    let log_scale = read3(log_scales, 3 * i);
    let logit = logits[i];
    let mut usable = is_finite(logit);
    usable = usable && is_finite(mean.x) && is_finite(mean.y) && is_finite(mean.z);
    usable = usable && is_finite(log_scale.x) && is_finite(log_scale.y) && is_finite(log_scale.z);
    #[unroll]
    for k in 0..4usize {
        usable = usable && is_finite(rotations[4 * i + k]);
    }
    if !usable {
        report[0].fetch_add(1u32);
        terminate!();
    }
    let offset = offset_from_camera(view, &mean);
    let p = to_camera(view, &offset);
    if !(is_finite(p.x) && is_finite(p.y) && is_finite(p.z)) || p.z <= view[NEAR] {
        terminate!();
    }
    let e = ewa(view, &p, log_scales, rotations, i);
    let low = view[LOW_PASS];
    let n1 = dot(&e.m1, &e.m1);
    let n2 = dot(&e.m2, &e.m2);
    let yy = n2 + low;
    let slope = dot(&e.m1, &e.m2) / yy;
    let area = rows_cross(&e, view, p.z, yy.sqrt());
    let s2 = dot(&area, &area) + low * ((n1 + n2 + low) / yy);
    let xx = s2 + slope * slope * yy;
    // ln(sigmoid(x)) = -ln(1 + e^-x)
    let log_opacity = min(logit, 0.0f32) - ((-logit.abs()).exp() + 1.0f32).ln();
    let x = fma(view[FOCAL], quotient(p.x, p.z), view[PRINCIPAL]);
    let y = fma(view[FOCAL + 1], quotient(p.y, p.z), view[PRINCIPAL + 1]);
    let du = 1.0f32 / (2.0f32 * s2).sqrt();
    let dv = 1.0f32 / (2.0f32 * yy).sqrt();
    let finite = is_finite(x) && is_finite(y) && is_finite(slope) && is_finite(xx) && is_finite(yy);
    if !finite || !is_finite(du) || !is_finite(dv) || du < NORMAL || dv < NORMAL {
        terminate!();
    }
    let tau = log_opacity - view[LN_ALPHA_MIN];
    if tau < 0.0f32 {
        terminate!();
    }
    let reach_x = (2.0f32 * tau).sqrt() * xx.sqrt();
    let reach_y = (2.0f32 * tau).sqrt() * yy.sqrt();
    let out_x = x + reach_x < 0.0f32 || x - reach_x > view[SIZE];
    let out_y = y + reach_y < 0.0f32 || y - reach_y > view[SIZE + 1];
    if out_x || out_y {
        terminate!();
    }
    let covariance = slope * yy;
    let difference = 0.5f32 * (xx - yy);
    let lambda = 0.5f32 * (xx + yy) + (difference * difference + covariance * covariance).sqrt();
    radii[i] = u32::cast_from(max(1.0f32, min((3.0f32 * lambda.sqrt()).ceil(), 4e9f32)));
    depths[i] = u32::reinterpret(p.z);
    splats[SPLAT * i] = x;
    splats[SPLAT * i + 1] = y;
    splats[SPLAT * i + 2] = slope;
    splats[SPLAT * i + 3] = du;
    splats[SPLAT * i + 4] = dv;
    splats[SPLAT * i + 5] = log_opacity;
    splats[SPLAT * i + 6] = (tau + 1e-3f32).sqrt();
    splats[SPLAT * i + 7] = p.z;
}

/// Result of [`project`], one row for each Gaussian of the scene.
pub(super) struct ProjectedScene {
    /// `[N, SPLAT]`; rows of culled Gaussians are undefined.
    pub splats: CubeTensor,
    /// Bits of camera z, which ascend with it.
    pub depths: CubeTensor,
    /// 0 = culled.
    pub radii: CubeTensor,
}

/// Projects `inputs`; adds rows with a NaN or an infinity to `report[0]`.
pub(super) fn project(
    gpu: &Gpu,
    inputs: &Inputs,
    view: &CubeTensor,
    report: &CubeTensor,
) -> ProjectedScene {
    let out = ProjectedScene {
        splats: gpu.floats([inputs.len(), SPLAT]),
        depths: gpu.words(inputs.len()),
        radii: gpu.words(inputs.len()),
    };
    if inputs.len() > 0 {
        launch!(gpu, project_kernel, gpu.cubes_for(inputs.len());
            &inputs.means, &inputs.log_scales, &inputs.rotations, &inputs.logits, view, &out.splats,
            &out.depths, &out.radii, report;
            inputs.len() as u32);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Settings;
    use crate::raster::gpu::covers;
    use crate::raster::gpu::fixture::{View, floats, words};

    #[test]
    fn projections_agree() {
        let Some(view) = View::new(3000, 0.05, [120, 77], &Settings::default()) else {
            return;
        };
        assert!(covers(&view.prepared.view), "this device runs the kernels");
        let splats = floats(&view.gpu, &view.prepared.projected.splats);
        let mut culled = vec![true; view.host.len()];
        for (splat, &id) in view.host.splats.iter().zip(&view.host.ids) {
            culled[id as usize] = false;
            let got = &splats[id as usize * SPLAT..][..SPLAT];
            let want = [
                splat.center[0],
                splat.center[1],
                splat.slope,
                splat.du,
                splat.dv,
                splat.log_opacity,
                splat.reach,
            ];
            for (field, (&got, want)) in got.iter().zip(want).enumerate() {
                // Cancellation in the slope is relative to the ellipse, and in the centre to the image.
                let size = if field < 2 {
                    120.0
                } else {
                    want.abs().max(0.1)
                };
                assert!(
                    (f64::from(got) - want).abs() < 2e-5 * size,
                    "Gaussian {id}, field {field}: {got}, expected {want}"
                );
            }
        }
        let radii = words(&view.gpu, &view.prepared.projected.radii);
        let differing = radii
            .iter()
            .zip(&culled)
            .filter(|&(&r, &culled)| (r == 0) != culled)
            .count();
        assert!(differing <= 2, "{differing} fates differ");
    }
}
