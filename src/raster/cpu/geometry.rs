//! EWA projection of one Gaussian (Eq. 1-2) and its derivative, in `f64`.
//!
//! `M = J W R S` (2 x 3, rows `m1`, `m2`), `Sigma2D = M M^T + low_pass I = [[X, B], [B, Y]]`. The exponent is written with
//! the slope `k = B / Y` and the variance of x given y, `s2 = det / Y`:
//! `-(u^2 + v^2)`, `u = (dx - k dy) / sqrt(2 s2)`, `v = dy / sqrt(2 Y)`, so it is never positive.
//! `det = |m1 x m2|^2 + low_pass (|m1|^2 + |m2|^2) + low_pass^2` is a sum of positive terms, and `m1 x m2` comes from the
//! viewing ray, `(m1 x m2)_i = s_j s_k (n . r_i)` with `n = fx fy / z^2 (tx, ty, 1)` in camera axes: thin splats do not cancel.

use crate::backend::Real;
use crate::backend::elementary::exp;
use crate::error::Result;
use crate::raster::settings::Splats;
use crate::splat::ZERO_QUATERNION;
use crate::splat::camera::Camera;

pub(super) type Vec3 = [f64; 3];

#[inline(always)]
pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `f v`.
#[inline(always)]
fn times(f: f64, v: Vec3) -> Vec3 {
    [f * v[0], f * v[1], f * v[2]]
}

/// A camera as the kernels use it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewpoint {
    /// Rows of the world-to-camera rotation.
    pub axes: [Vec3; 3],
    pub center: Vec3,
    pub focal: [f64; 2],
    pub principal: [f64; 2],
    /// Image size, pixels.
    pub size: [usize; 2],
    /// Range of x/z and of y/z within which the Jacobian is taken.
    pub limits: [[f64; 2]; 2],
}

impl Viewpoint {
    /// # Errors
    /// Those of [`Camera::check`].
    pub fn new(camera: &Camera) -> Result<Self> {
        camera.check()?;
        let Camera {
            rotation,
            center,
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        } = camera;
        let limits =
            |f: f64, c: f64, n: usize| [-(0.15 * n as f64 + c) / f, (1.15 * n as f64 - c) / f];
        Ok(Self {
            axes: rotation.transpose().to_cols_array_2d(),
            center: center.to_array(),
            focal: [*fx, *fy],
            principal: [*cx, *cy],
            size: [*width, *height],
            limits: [limits(*fx, *cx, *width), limits(*fy, *cy, *height)],
        })
    }

    /// A point of the world in camera coordinates.
    #[inline(always)]
    pub fn to_camera(self, point: Vec3) -> Vec3 {
        let offset = [
            point[0] - self.center[0],
            point[1] - self.center[1],
            point[2] - self.center[2],
        ];
        [
            dot(self.axes[0], offset),
            dot(self.axes[1], offset),
            dot(self.axes[2], offset),
        ]
    }
}

/// One Gaussian in world space, in `f64`.
#[derive(Clone, Copy)]
pub(super) struct Splat3 {
    pub mean: Vec3,
    pub log_scale: Vec3,
    pub rotation: [f64; 4],
    pub logit: f64,
}

impl Splat3 {
    #[inline(always)]
    pub fn read<E: Real>(s: &Splats<'_, E>, i: usize) -> Self {
        let [m, l, q] = [
            &s.means[3 * i..3 * i + 3],
            &s.log_scales[3 * i..3 * i + 3],
            &s.rotations[4 * i..4 * i + 4],
        ];
        Self {
            mean: [m[0].wide(), m[1].wide(), m[2].wide()],
            log_scale: [l[0].wide(), l[1].wide(), l[2].wide()],
            rotation: [q[0].wide(), q[1].wide(), q[2].wide(), q[3].wide()],
            logit: s.opacity_logits[i].wide(),
        }
    }
}

/// `1 / (1 + e^-x)`.
#[inline(always)]
fn sigmoid(x: f64) -> f64 {
    let e = exp(-x.abs());
    if x >= 0.0 {
        1.0 / (1.0 + e)
    } else {
        e / (1.0 + e)
    }
}

/// A unit quaternion, the length it was divided by, and whether it stands in for a zero one.
struct Unit {
    q: [f64; 4],
    length: f64,
    zero: bool,
}

impl Unit {
    #[inline(always)]
    fn new(raw: [f64; 4]) -> Self {
        // Dividing by the largest entry first keeps the squares of huge quaternions finite.
        let largest = raw[0]
            .abs()
            .max(raw[1].abs())
            .max(raw[2].abs().max(raw[3].abs()));
        let scaled = raw.map(|v| v / largest);
        let norm = (scaled[0] * scaled[0]
            + scaled[1] * scaled[1]
            + scaled[2] * scaled[2]
            + scaled[3] * scaled[3])
            .sqrt();
        let length = norm * largest;
        // 0 / 0 counts as zero too.
        let zero = length.is_nan() | (length * length < ZERO_QUATERNION);
        let identity = [1.0, 0.0, 0.0, 0.0];
        let q = std::array::from_fn(|i| if zero { identity[i] } else { scaled[i] / norm });
        Self {
            q,
            length: if zero { 1.0 } else { length },
            zero,
        }
    }

    /// Columns of the rotation matrix.
    #[inline(always)]
    fn columns(&self) -> [Vec3; 3] {
        let [w, x, y, z] = self.q;
        [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y + w * z),
                2.0 * (x * z - w * y),
            ],
            [
                2.0 * (x * y - w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z + w * x),
            ],
            [
                2.0 * (x * z + w * y),
                2.0 * (y * z - w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ]
    }

    /// Gradient of the raw quaternion from those of the columns.
    fn backward(&self, d: &[Vec3; 3]) -> [f64; 4] {
        if self.zero {
            return [0.0; 4];
        }
        let [w, x, y, z] = self.q;
        // d[c][r] is the gradient of matrix entry (r, c).
        let g = [
            2.0 * (x * (d[1][2] - d[2][1]) + y * (d[2][0] - d[0][2]) + z * (d[0][1] - d[1][0])),
            2.0 * (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[1][2] - d[2][1]))
                - 4.0 * x * (d[1][1] + d[2][2]),
            2.0 * (x * (d[1][0] + d[0][1]) + z * (d[2][1] + d[1][2]) + w * (d[2][0] - d[0][2]))
                - 4.0 * y * (d[0][0] + d[2][2]),
            2.0 * (x * (d[2][0] + d[0][2]) + y * (d[2][1] + d[1][2]) + w * (d[0][1] - d[1][0]))
                - 4.0 * z * (d[0][0] + d[1][1]),
        ];
        let along: f64 = self.q.iter().zip(&g).map(|(q, g)| q * g).sum();
        std::array::from_fn(|i| (g[i] - self.q[i] * along) / self.length)
    }
}

/// The projection with everything that its derivative needs.
pub(super) struct Ewa {
    /// Camera coordinates.
    p: Vec3,
    /// x/z and y/z as the Jacobian takes them, and whether each is inside its limits.
    tangent: [f64; 2],
    inside: [bool; 2],
    /// Rows of `J W`.
    jw: [Vec3; 2],
    unit: Unit,
    columns: [Vec3; 3],
    scale: Vec3,
    /// Rows of `M`.
    pub m: [Vec3; 2],
}

impl Ewa {
    /// Projects a Gaussian at `p` in camera coordinates.
    #[inline(always)]
    pub fn new(rotation: [f64; 4], scale: Vec3, v: &Viewpoint, p: Vec3) -> Self {
        // No `from_fn` within `from_fn`: where a closure is not inlined, loops over Gaussians do not become vectors.
        let along = |a: usize| {
            let ratio = p[a] / p[2];
            let [low, high] = v.limits[a];
            let tangent = ratio.max(low).min(high);
            let (w, z) = (v.axes[a], v.axes[2]);
            let row = [
                w[0] - tangent * z[0],
                w[1] - tangent * z[1],
                w[2] - tangent * z[2],
            ];
            (
                tangent,
                (ratio > low) & (ratio < high),
                times(v.focal[a] / p[2], row),
            )
        };
        let (x, y) = (along(0), along(1));
        let tangent = [x.0, y.0];
        let inside = [x.1, y.1];
        let jw = [x.2, y.2];
        let unit = Unit::new(rotation);
        let columns = unit.columns();
        let row = |w: Vec3| {
            [
                scale[0] * dot(w, columns[0]),
                scale[1] * dot(w, columns[1]),
                scale[2] * dot(w, columns[2]),
            ]
        };
        let m = [row(jw[0]), row(jw[1])];
        Self {
            p,
            tangent,
            inside,
            jw,
            unit,
            columns,
            scale,
            m,
        }
    }

    /// `|m1 x m2|^2` without cancellation.
    #[inline(always)]
    pub fn cross_squared(&self, v: &Viewpoint) -> f64 {
        let area = v.focal[0] * v.focal[1] / (self.p[2] * self.p[2]);
        let [x, y, z] = v.axes;
        let [tx, ty] = self.tangent;
        let ray = [
            tx * x[0] + ty * y[0] + z[0],
            tx * x[1] + ty * y[1] + z[1],
            tx * x[2] + ty * y[2] + z[2],
        ];
        let [a, b, c] = self.scale;
        let part = |others: f64, column: Vec3| others * area * dot(ray, column);
        let parts = [
            part(b * c, self.columns[0]),
            part(a * c, self.columns[1]),
            part(a * b, self.columns[2]),
        ];
        dot(parts, parts)
    }
}

/// Sums over pixels of `g = dL/dalpha' alpha'` (zero where the cap holds) times 1, u, v, u^2, u v, v^2.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    pub one: f64,
    pub u: f64,
    pub v: f64,
    pub uu: f64,
    pub uv: f64,
    pub vv: f64,
}

/// Gradient of one Gaussian's geometry.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gradient3 {
    pub mean: Vec3,
    pub log_scale: Vec3,
    pub rotation: [f64; 4],
    pub logit: f64,
    /// With respect to the pixel coordinates of the centre.
    pub center: [f64; 2],
}

/// The derivative of the projection followed by the exponent, for a Gaussian that it called visible.
pub(super) fn project_backward(
    s: &Splat3,
    v: &Viewpoint,
    e: &super::footprint::Splat2,
    sums: &Moments,
    low_pass: f64,
) -> Gradient3 {
    let p = v.to_camera(s.mean);
    let z = p[2];
    let ewa = Ewa::new(s.rotation, s.log_scale.map(exp), v, p);
    let [m1, m2] = ewa.m;
    let yy = dot(m2, m2) + low_pass;
    let (slope, du, dv) = (e.slope, e.du, e.dv);

    let du_center = 2.0 * du * sums.u;
    let center = [du_center, 2.0 * dv * sums.v - slope * du_center];
    let d_slope = 2.0 * du / dv * sums.uv;
    let d_s2 = 2.0 * du * du * sums.uu;
    // s2 = X - B^2 / Y, k = B / Y.
    let d_xx = d_s2;
    let d_b = d_slope / yy - 2.0 * slope * d_s2;
    let d_yy = slope * slope * d_s2 - d_slope * slope / yy + sums.vv / yy;

    let mut d_jw = [[0.0; 3]; 2];
    let mut d_columns = [[0.0; 3]; 3];
    let mut log_scale = [0.0; 3];
    for i in 0..3 {
        let d_m = [
            2.0 * d_xx * m1[i] + d_b * m2[i],
            2.0 * d_yy * m2[i] + d_b * m1[i],
        ];
        log_scale[i] = d_m[0] * m1[i] + d_m[1] * m2[i];
        for a in 0..2 {
            let d = d_m[a] * ewa.scale[i];
            for r in 0..3 {
                d_jw[a][r] += d * ewa.columns[i][r];
                d_columns[i][r] += d * ewa.jw[a][r];
            }
        }
    }
    let mut d_p = [0.0; 3];
    for a in 0..2 {
        let f = v.focal[a] / z;
        // J holds f and, where x/z is not clamped, x/z.
        d_p[2] -= dot(d_jw[a], ewa.jw[a]) / z;
        let d_tangent = if ewa.inside[a] {
            -f * dot(d_jw[a], v.axes[2])
        } else {
            0.0
        };
        let d_ratio = d_tangent + v.focal[a] * center[a];
        d_p[a] += d_ratio / z;
        d_p[2] -= d_ratio * p[a] / (z * z);
    }
    let mean = std::array::from_fn(|i| (0..3).map(|a| v.axes[a][i] * d_p[a]).sum());
    Gradient3 {
        mean,
        log_scale,
        rotation: ewa.unit.backward(&d_columns),
        logit: sums.one * sigmoid(-s.logit),
        center,
    }
}
