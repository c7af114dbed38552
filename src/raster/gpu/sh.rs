//! Colours from spherical harmonics and their derivative: [`crate::raster::cpu::sh`]'s formulas, one unit for each Gaussian.

use super::ewa::offset_from_camera;
use super::vec3::{Vec3, dot, read3, vec3};
use crate::backend::gpu::{Gpu, launch};
use crate::splat::sh::{C0, C1, C2, C3};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// The functions up to `degree` at the unit direction `d`.
#[cube]
fn basis(d: &Vec3, #[comptime] degree: u32) -> Array<f32> {
    let mut b = Array::<f32>::new(16usize);
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    b[0] = f32::new(C0 as f32);
    if comptime![degree > 0] {
        b[1] = -(C1 as f32) * y;
        b[2] = C1 as f32 * z;
        b[3] = -(C1 as f32) * x;
    }
    if comptime![degree > 1] {
        b[4] = comptime![C2[0] as f32] * x * y;
        b[5] = comptime![C2[1] as f32] * y * z;
        b[6] = comptime![C2[2] as f32] * (2.0f32 * zz - xx - yy);
        b[7] = comptime![C2[3] as f32] * x * z;
        b[8] = comptime![C2[4] as f32] * (xx - yy);
    }
    if comptime![degree > 2] {
        b[9] = comptime![C3[0] as f32] * y * (3.0f32 * xx - yy);
        b[10] = comptime![C3[1] as f32] * x * y * z;
        b[11] = comptime![C3[2] as f32] * y * (4.0f32 * zz - xx - yy);
        b[12] = comptime![C3[3] as f32] * z * (2.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
        b[13] = comptime![C3[4] as f32] * x * (4.0f32 * zz - xx - yy);
        b[14] = comptime![C3[5] as f32] * z * (xx - yy);
        b[15] = comptime![C3[6] as f32] * x * (xx - 3.0f32 * yy);
    }
    b
}

/// Gradient of `sum_k g[k] basis[k]` with respect to the direction, components taken as independent.
#[cube]
fn basis_backward(v: &Vec3, g: &Array<f32>, #[comptime] degree: u32) -> Vec3 {
    let (x, y, z) = (v.x, v.y, v.z);
    let mut dx = 0.0f32;
    let mut dy = 0.0f32;
    let mut dz = 0.0f32;
    if comptime![degree > 0] {
        dx = -(C1 as f32) * g[3];
        dy = -(C1 as f32) * g[1];
        dz = C1 as f32 * g[2];
    }
    if comptime![degree > 1] {
        let a = comptime![C2[0] as f32] * g[4];
        let b = comptime![C2[1] as f32] * g[5];
        let c = comptime![C2[2] as f32] * g[6];
        let e = comptime![C2[3] as f32] * g[7];
        let f = comptime![C2[4] as f32] * g[8];
        dx += a * y - 2.0f32 * c * x + e * z + 2.0f32 * f * x;
        dy += a * x + b * z - 2.0f32 * c * y - 2.0f32 * f * y;
        dz += b * y + 4.0f32 * c * z + e * x;
    }
    if comptime![degree > 2] {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let k0 = comptime![C3[0] as f32] * g[9];
        let k1 = comptime![C3[1] as f32] * g[10];
        let k2 = comptime![C3[2] as f32] * g[11];
        let k3 = comptime![C3[3] as f32] * g[12];
        let k4 = comptime![C3[4] as f32] * g[13];
        let k5 = comptime![C3[5] as f32] * g[14];
        let k6 = comptime![C3[6] as f32] * g[15];
        dx += 6.0f32 * k0 * x * y + k1 * y * z - 2.0f32 * k2 * x * y - 6.0f32 * k3 * x * z
            + k4 * (4.0f32 * zz - 3.0f32 * xx - yy)
            + 2.0f32 * k5 * x * z
            + 3.0f32 * k6 * (xx - yy);
        dy += 3.0f32 * k0 * (xx - yy) + k1 * x * z + k2 * (4.0f32 * zz - xx - 3.0f32 * yy)
            - 6.0f32 * k3 * y * z
            - 2.0f32 * k4 * x * y
            - 2.0f32 * k5 * y * z
            - 6.0f32 * k6 * x * y;
        dz += k1 * x * y
            + 8.0f32 * k2 * y * z
            + k3 * (6.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy)
            + 8.0f32 * k4 * x * z
            + k5 * (xx - yy);
    }
    vec3(dx, dy, dz)
}

/// Unit direction of `v`, zero where `v` is.
#[cube]
fn direction(v: &Vec3, length: f32) -> Vec3 {
    let by = select(length > 0.0f32, length, 1.0f32);
    vec3(v.x / by, v.y / by, v.z / by)
}

#[cube]
fn length_of(v: &Vec3) -> f32 {
    // By the largest entry first, so that the squares neither overflow nor vanish.
    let largest = max(max(v.x.abs(), v.y.abs()), v.z.abs());
    let by = select(largest > 0.0f32, largest, 1.0f32);
    let u = vec3(v.x / by, v.y / by, v.z / by);
    dot(&u, &u).sqrt() * largest
}

#[cube(launch)]
fn eval_colours(
    means: &[f32],
    sh: &[f32],
    radii: &[u32],
    view: &[f32],
    colours: &mut [f32],
    count: u32,
    #[comptime] stored: usize,
    #[comptime] degree: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    if radii[i] > 0u32 {
        let offset = offset_from_camera(view, &read3(means, 3 * i));
        let b = basis(&direction(&offset, length_of(&offset)), degree);
        red = 0.5f32;
        green = 0.5f32;
        blue = 0.5f32;
        #[unroll]
        for k in 0..comptime![((degree + 1) * (degree + 1)) as usize] {
            let at = 3 * (i * stored + k);
            red += b[k] * sh[at];
            green += b[k] * sh[at + 1];
            blue += b[k] * sh[at + 2];
        }
    }
    colours[3 * i] = max(red, 0.0f32);
    colours[3 * i + 1] = max(green, 0.0f32);
    colours[3 * i + 2] = max(blue, 0.0f32);
}

#[cube(launch)]
fn colours_backward(
    means: &[f32],
    sh: &[f32],
    radii: &[u32],
    view: &[f32],
    values: &[f32],
    d_values: &[f32],
    d_sh: &mut [f32],
    d_means: &mut [f32],
    count: u32,
    channels: u32,
    #[comptime] stored: usize,
    #[comptime] degree: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let terms = comptime![((degree + 1) * (degree + 1)) as usize];
    // The colour is 0 where max(0, .) cut it off, and where the Gaussian is culled.
    let at = i * channels as usize;
    let gx = select(values[at] > 0.0f32, d_values[at], 0.0f32);
    let gy = select(values[at + 1] > 0.0f32, d_values[at + 1], 0.0f32);
    let gz = select(values[at + 2] > 0.0f32, d_values[at + 2], 0.0f32);
    let offset = offset_from_camera(view, &read3(means, 3 * i));
    let length = length_of(&offset);
    let d = direction(&offset, length);
    let b = basis(&d, degree);
    #[unroll]
    for k in 0..stored {
        let at = 3 * (i * stored + k);
        if comptime![k < terms] {
            d_sh[at] = b[k] * gx;
            d_sh[at + 1] = b[k] * gy;
            d_sh[at + 2] = b[k] * gz;
        } else {
            d_sh[at] = 0.0f32;
            d_sh[at + 1] = 0.0f32;
            d_sh[at + 2] = 0.0f32;
        }
    }
    if comptime![degree > 0] && radii[i] > 0u32 && length > 0.0f32 {
        // Not in the loop above: a load that follows a store waits for it.
        let mut d_basis = Array::<f32>::new(16usize);
        #[unroll]
        for k in 0..terms {
            let at = 3 * (i * stored + k);
            d_basis[k] = sh[at] * gx + sh[at + 1] * gy + sh[at + 2] * gz;
        }
        let d_direction = basis_backward(&d, &d_basis, degree);
        let along = dot(&d, &d_direction);
        d_means[3 * i] += (d_direction.x - d.x * along) / length;
        d_means[3 * i + 1] += (d_direction.y - d.y * along) / length;
        d_means[3 * i + 2] += (d_direction.z - d.z * along) / length;
    }
}

/// SH coefficients `[N, stored, 3]`. Those up to `degree` are in use.
pub(crate) struct Harmonics {
    pub(super) sh: CubeTensor,
    stored: usize,
    degree: u32,
}

impl Harmonics {
    /// The coefficients `[N, K, 3]` up to the degree `active`.
    pub fn new(sh: CubeTensor, active: usize) -> Self {
        let stored = sh.meta.shape()[1];
        let degree = active.min(stored.isqrt().saturating_sub(1)) as u32;
        Self { sh, stored, degree }
    }

    /// `max(0, SH(direction) + 0.5)`, `[N, 3]`; 0 for culled Gaussians.
    pub(super) fn colours(
        &self,
        means: &CubeTensor,
        radii: &CubeTensor,
        view: &CubeTensor,
    ) -> CubeTensor {
        let gpu = Gpu::of(means);
        let count = means.meta.shape()[0];
        let out = gpu.floats([count, 3]);
        launch!(gpu, eval_colours, gpu.cubes_for(count);
            means, &self.sh, radii, view, &out; count as u32, self.stored, self.degree);
        out
    }

    /// Gradient of the coefficients; that of the means, through the direction, is added to `d_means`. `values` are those that were
    /// blended, `[N, C]`, colours first, and `d_values` their gradients.
    pub(super) fn backward(
        &self,
        means: &CubeTensor,
        radii: &CubeTensor,
        view: &CubeTensor,
        values: &CubeTensor,
        d_values: &CubeTensor,
        d_means: &CubeTensor,
    ) -> CubeTensor {
        let gpu = Gpu::of(means);
        let count = means.meta.shape()[0];
        let channels = values.meta.num_elements() / count.max(1);
        let out = gpu.floats([count, self.stored, 3]);
        launch!(gpu, colours_backward, gpu.cubes_for(count);
            means, &self.sh, radii, view, values, d_values, &out, d_means;
            count as u32, channels as u32, self.stored, self.degree);
        out
    }
}
