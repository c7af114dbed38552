//! From the sums over pixels to the gradients of the parameters: one unit for each Gaussian.

use super::batch::ABSOLUTE_MOMENTS;
use super::ewa::{Ewa, Unit, ewa, offset_from_camera, rows_cross, to_camera};
use super::inputs::Inputs;
use super::project::{ProjectedScene, SPLAT};
use super::vec3::{Vec3, add_scaled, cross, dot, read3, scaled, vec3, write3};
use super::view::{AXES, FOCAL, LOW_PASS, SIZE};
use crate::backend::gpu::{Gpu, launch};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Writes the gradient of the raw quaternion from those of the columns of its matrix.
#[cube]
fn write_rotation(to: &mut [f32], i: usize, q: &Unit, d0: &Vec3, d1: &Vec3, d2: &Vec3) {
    let (w, x, y, z) = (q.w, q.x, q.y, q.z);
    let gw = 2.0f32 * (x * (d1.z - d2.y) + y * (d2.x - d0.z) + z * (d0.y - d1.x));
    let gx = 2.0f32 * (y * (d1.x + d0.y) + z * (d2.x + d0.z) + w * (d1.z - d2.y))
        - 4.0f32 * x * (d1.y + d2.z);
    let gy = 2.0f32 * (x * (d1.x + d0.y) + z * (d2.y + d1.z) + w * (d2.x - d0.z))
        - 4.0f32 * y * (d0.x + d2.z);
    let gz = 2.0f32 * (x * (d2.x + d0.z) + y * (d2.y + d1.z) + w * (d0.y - d1.x))
        - 4.0f32 * z * (d0.x + d1.y);
    let along = w * gw + x * gx + y * gy + z * gz;
    // A zero quaternion has no gradient.
    let whole = q.length > 0.0f32;
    let by = select(whole, q.length, 1.0f32);
    to[4 * i] = select(whole, (gw - w * along) / by, 0.0f32);
    to[4 * i + 1] = select(whole, (gx - x * along) / by, 0.0f32);
    to[4 * i + 2] = select(whole, (gy - y * along) / by, 0.0f32);
    to[4 * i + 3] = select(whole, (gz - z * along) / by, 0.0f32);
}

/// Writes `count` zeros from `at` on.
#[cube]
fn write_zeros(to: &mut [f32], at: usize, #[comptime] count: usize) {
    #[unroll]
    for k in 0..count {
        to[at + k] = 0.0f32;
    }
}

/// Writes the gradient of the mean from those of the projected centre and of the rows of J; `p` is the mean in the camera's frame.
#[cube]
fn write_mean(
    to: &mut [f32],
    i: usize,
    view: &[f32],
    p: &Vec3,
    e: &Ewa,
    d_x: f32,
    d_y: f32,
    d_jx: &Vec3,
    d_jy: &Vec3,
) {
    // J holds f / z and, where x/z is not clamped, x/z.
    let forward = read3(view, AXES + 6);
    let (fx, fy) = (view[FOCAL] / p.z, view[FOCAL + 1] / p.z);
    let d_ratio_x = view[FOCAL] * d_x - e.inside_x * fx * dot(d_jx, &forward);
    let d_ratio_y = view[FOCAL + 1] * d_y - e.inside_y * fy * dot(d_jy, &forward);
    let d_px = d_ratio_x / p.z;
    let d_py = d_ratio_y / p.z;
    let d_pz =
        -(dot(d_jx, &e.jx) + dot(d_jy, &e.jy)) / p.z - d_px * (p.x / p.z) - d_py * (p.y / p.z);
    let right = read3(view, AXES);
    let down = read3(view, AXES + 3);
    let d_mean = add_scaled(
        &add_scaled(&scaled(d_px, &right), d_py, &down),
        d_pz,
        &forward,
    );
    write3(to, 3 * i, &d_mean);
}

#[cube(launch)]
fn parameters_backward(
    means: &[f32],
    log_scales: &[f32],
    rotations: &[f32],
    logits: &[f32],
    view: &[f32],
    splats: &[f32],
    radii: &[u32],
    moments: &[f32],
    d_means: &mut [f32],
    d_log_scales: &mut [f32],
    d_rotations: &mut [f32],
    d_logits: &mut [f32],
    d_screen: &mut [f32],
    count: u32,
    #[comptime] sums: usize,
) {
    let screen = comptime![if sums == ABSOLUTE_MOMENTS {
        4usize
    } else {
        2usize
    }];
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    if radii[i] == 0u32 {
        write_zeros(d_means, 3 * i, 3usize);
        write_zeros(d_log_scales, 3 * i, 3usize);
        write_zeros(d_rotations, 4 * i, 4usize);
        write_zeros(d_logits, i, 1usize);
        write_zeros(d_screen, screen * i, screen);
        terminate!();
    }
    let slope = splats[SPLAT * i + 2];
    let du = splats[SPLAT * i + 3];
    let dv = splats[SPLAT * i + 4];
    let at = sums * i;
    let sum_u = moments[at + 1];
    let sum_v = moments[at + 2];
    let sum_uu = moments[at + 3];
    let sum_uv = moments[at + 4];
    let sum_vv = moments[at + 5];
    let p = to_camera(view, &offset_from_camera(view, &read3(means, 3 * i)));
    let e = ewa(view, &p, log_scales, rotations, i);
    let yy = dot(&e.m2, &e.m2) + view[LOW_PASS];

    let d_x = 2.0f32 * du * sum_u;
    let d_y = 2.0f32 * dv * sum_v - slope * d_x;
    // The columns c_i = (m1_i, m2_i) of M as offsets in u and v, where m1_i - slope m2_i would cancel for needles:
    // Y m1 - B m2 = low_pass m1 + m2 x (m1 x m2).
    let across = cross(&e.m2, &rows_cross(&e, view, p.z, yy));
    let cu = scaled(du, &add_scaled(&across, view[LOW_PASS] / yy, &e.m1));
    let cv = scaled(dv, &e.m2);
    // The exponent grows by (2 u cu_i + 2 v cv_i) times its own derivative by the offset.
    let du_sum = add_scaled(&scaled(4.0f32 * sum_uu, &cu), 4.0f32 * sum_uv, &cv);
    let dv_sum = add_scaled(&scaled(4.0f32 * sum_uv, &cu), 4.0f32 * sum_vv, &cv);
    d_log_scales[3 * i] = cu.x * du_sum.x + cv.x * dv_sum.x;
    d_log_scales[3 * i + 1] = cu.y * du_sum.y + cv.y * dv_sum.y;
    d_log_scales[3 * i + 2] = cu.z * du_sum.z + cv.z * dv_sum.z;
    let d_m1 = scaled(du, &du_sum);
    let d_m2 = add_scaled(&scaled(dv, &dv_sum), -slope, &d_m1);
    // m1_i = s_i (jx . r_i), m2_i = s_i (jy . r_i).
    let a = vec3(d_m1.x * e.scale.x, d_m1.y * e.scale.y, d_m1.z * e.scale.z);
    let b = vec3(d_m2.x * e.scale.x, d_m2.y * e.scale.y, d_m2.z * e.scale.z);
    let d_jx = add_scaled(&add_scaled(&scaled(a.x, &e.r0), a.y, &e.r1), a.z, &e.r2);
    let d_jy = add_scaled(&add_scaled(&scaled(b.x, &e.r0), b.y, &e.r1), b.z, &e.r2);
    let d_r0 = add_scaled(&scaled(a.x, &e.jx), b.x, &e.jy);
    let d_r1 = add_scaled(&scaled(a.y, &e.jx), b.y, &e.jy);
    let d_r2 = add_scaled(&scaled(a.z, &e.jx), b.z, &e.jy);
    write_rotation(d_rotations, i, &e.unit, &d_r0, &d_r1, &d_r2);

    write_mean(d_means, i, view, &p, &e, d_x, d_y, &d_jx, &d_jy);
    // The derivative of ln(sigmoid(x)) is sigmoid(-x).
    let logit = logits[i];
    let small = (-logit.abs()).exp();
    d_logits[i] = moments[at] * select(logit >= 0.0f32, small, 1.0f32) / (1.0f32 + small);
    d_screen[screen * i] = 0.5f32 * view[SIZE] * d_x;
    d_screen[screen * i + 1] = 0.5f32 * view[SIZE + 1] * d_y;
    if comptime![sums == ABSOLUTE_MOMENTS] {
        d_screen[screen * i + 2] = view[SIZE] * du.abs() * moments[at + 6];
        d_screen[screen * i + 3] = view[SIZE + 1] * moments[at + 7];
    }
}

/// Gradients of the geometry.
pub(crate) struct GeometryGradients {
    pub means: CubeTensor,
    pub log_scales: CubeTensor,
    pub rotations: CubeTensor,
    pub logits: CubeTensor,
    /// Gradients of the projected centres in units of half the image, `[N, 2]`, or `[N, 4]` with sums of absolute values.
    pub screen: CubeTensor,
}

/// Gradients from `moments`, `[N, 6]` or `[N, 8]`, zero for culled Gaussians.
pub(super) fn backward(
    gpu: &Gpu,
    inputs: &Inputs,
    view: &CubeTensor,
    scene: &ProjectedScene,
    moments: &CubeTensor,
) -> GeometryGradients {
    let n = inputs.len();
    let sums = moments.meta.num_elements() / n.max(1);
    let out = GeometryGradients {
        means: gpu.floats([n, 3]),
        log_scales: gpu.floats([n, 3]),
        rotations: gpu.floats([n, 4]),
        logits: gpu.floats([n]),
        screen: gpu.floats([n, if sums == ABSOLUTE_MOMENTS { 4 } else { 2 }]),
    };
    launch!(gpu, parameters_backward, gpu.cubes_for(n);
        &inputs.means, &inputs.log_scales, &inputs.rotations, &inputs.logits, view, &scene.splats,
        &scene.radii, moments, &out.means, &out.log_scales, &out.rotations, &out.logits, &out.screen;
        n as u32, sums);
    out
}
