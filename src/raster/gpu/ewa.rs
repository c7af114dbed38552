//! EWA projection of one Gaussian in kernels: [`crate::raster::cpu::geometry`]'s formulas, in `f32`.

use super::vec3::{Vec3, add_scaled, dot, read3, scaled, vec3};
use super::view::{AXES, CENTER, CENTER_REST, FOCAL, LIMITS};
use burn_cubecl::cubecl::{self, prelude::*};

/// A quaternion below this length counts as the identity.
const ZERO_LENGTH: f32 = 1e-6;

/// A unit quaternion and the length it was divided by; 0 when it replaces a zero quaternion.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Unit {
    pub w: f32,
    pub x: f32,
    pub y: f32,
    pub z: f32,
    pub length: f32,
}

/// The projection with everything that its derivative needs.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Ewa {
    /// x/z and y/z as the Jacobian takes them.
    pub tx: f32,
    pub ty: f32,
    /// 1 inside the limits of the Jacobian, else 0.
    pub inside_x: f32,
    pub inside_y: f32,
    /// Rows of `J W`.
    pub jx: Vec3,
    pub jy: Vec3,
    pub unit: Unit,
    /// Columns of the rotation matrix.
    pub r0: Vec3,
    pub r1: Vec3,
    pub r2: Vec3,
    pub scale: Vec3,
    /// Rows of `M`.
    pub m1: Vec3,
    pub m2: Vec3,
}

/// From the camera centre to `mean`, world axes.
#[cube]
pub(super) fn offset_from_camera(view: &[f32], mean: &Vec3) -> Vec3 {
    let center = read3(view, CENTER);
    let rest = read3(view, CENTER_REST);
    vec3(
        (mean.x - center.x) - rest.x,
        (mean.y - center.y) - rest.y,
        (mean.z - center.z) - rest.z,
    )
}

/// Camera coordinates of an offset in world axes.
#[cube]
pub(super) fn to_camera(view: &[f32], offset: &Vec3) -> Vec3 {
    let x = read3(view, AXES);
    let y = read3(view, AXES + 3);
    let z = read3(view, AXES + 6);
    vec3(dot(&x, offset), dot(&y, offset), dot(&z, offset))
}

#[cube]
fn unit(rotations: &[f32], at: usize) -> Unit {
    let (w, x, y, z) = (
        rotations[at],
        rotations[at + 1],
        rotations[at + 2],
        rotations[at + 3],
    );
    // Dividing by the largest entry first keeps the squares of huge quaternions finite.
    let largest = max(max(w.abs(), x.abs()), max(y.abs(), z.abs()));
    let by = select(largest > 0.0f32, largest, 1.0f32);
    let (w, x, y, z) = (w / by, x / by, y / by, z / by);
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let length = norm * largest;
    let zero = length < ZERO_LENGTH;
    let by = select(zero, 1.0f32, norm);
    Unit {
        w: select(zero, 1.0f32, w / by),
        x: select(zero, 0.0f32, x / by),
        y: select(zero, 0.0f32, y / by),
        z: select(zero, 0.0f32, z / by),
        length: select(zero, 0.0f32, length),
    }
}

/// Row of `J W` for the image axis `a`.
#[cube]
fn jacobian_row(view: &[f32], tangent: f32, z: f32, #[comptime] a: usize) -> Vec3 {
    let axis = read3(view, AXES + 3 * a);
    let depth = read3(view, AXES + 6);
    let row = add_scaled(&axis, -tangent, &depth);
    scaled(view[FOCAL + a] / z, &row)
}

/// The projection of Gaussian `i` at camera coordinates `p`.
#[cube]
pub(super) fn ewa(view: &[f32], p: &Vec3, log_scales: &[f32], rotations: &[f32], i: usize) -> Ewa {
    let raw_x = p.x / p.z;
    let raw_y = p.y / p.z;
    let tx = max(view[LIMITS], min(raw_x, view[LIMITS + 1]));
    let ty = max(view[LIMITS + 2], min(raw_y, view[LIMITS + 3]));
    let jx = jacobian_row(view, tx, p.z, 0usize);
    let jy = jacobian_row(view, ty, p.z, 1usize);
    let u = unit(rotations, 4 * i);
    let (w, x, y, z) = (u.w, u.x, u.y, u.z);
    let r0 = vec3(
        1.0f32 - 2.0f32 * (y * y + z * z),
        2.0f32 * (x * y + w * z),
        2.0f32 * (x * z - w * y),
    );
    let r1 = vec3(
        2.0f32 * (x * y - w * z),
        1.0f32 - 2.0f32 * (x * x + z * z),
        2.0f32 * (y * z + w * x),
    );
    let r2 = vec3(
        2.0f32 * (x * z + w * y),
        2.0f32 * (y * z - w * x),
        1.0f32 - 2.0f32 * (x * x + y * y),
    );
    let log_scale = read3(log_scales, 3 * i);
    let scale = vec3(log_scale.x.exp(), log_scale.y.exp(), log_scale.z.exp());
    let m1 = vec3(
        scale.x * dot(&jx, &r0),
        scale.y * dot(&jx, &r1),
        scale.z * dot(&jx, &r2),
    );
    let m2 = vec3(
        scale.x * dot(&jy, &r0),
        scale.y * dot(&jy, &r1),
        scale.z * dot(&jy, &r2),
    );
    Ewa {
        tx,
        ty,
        inside_x: select(
            raw_x > view[LIMITS] && raw_x < view[LIMITS + 1],
            1.0f32,
            0.0f32,
        ),
        inside_y: select(
            raw_y > view[LIMITS + 2] && raw_y < view[LIMITS + 3],
            1.0f32,
            0.0f32,
        ),
        jx,
        jy,
        unit: u,
        r0,
        r1,
        r2,
        scale,
        m1,
        m2,
    }
}

/// `(m1 x m2) / by` without cancellation; divided early, because the product alone may overflow.
#[cube]
pub(super) fn rows_cross(e: &Ewa, view: &[f32], z: f32, by: f32) -> Vec3 {
    let area = (view[FOCAL] / z) * (view[FOCAL + 1] / z) / by;
    let x = read3(view, AXES);
    let y = read3(view, AXES + 3);
    let forward = read3(view, AXES + 6);
    let ray = add_scaled(&add_scaled(&forward, e.tx, &x), e.ty, &y);
    vec3(
        e.scale.y * (e.scale.z * area) * dot(&ray, &e.r0),
        e.scale.x * (e.scale.z * area) * dot(&ray, &e.r1),
        e.scale.x * (e.scale.y * area) * dot(&ray, &e.r2),
    )
}
