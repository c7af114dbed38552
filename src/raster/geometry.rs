//! EWA projection of one Gaussian (Eq. 1-2) and its derivative, in `f64`.
//!
//! `M = J W R S` (2 x 3, rows `m1`, `m2`), `Sigma2D = M M^T + low_pass I = [[X, B], [B, Y]]`. The exponent is written with
//! the slope `k = B / Y` and the variance of x given y, `s2 = det / Y`:
//! `-(u^2 + v^2)`, `u = (dx - k dy) / sqrt(2 s2)`, `v = dy / sqrt(2 Y)`, so it is never positive.
//! `det = |m1 x m2|^2 + low_pass (|m1|^2 + |m2|^2) + low_pass^2` is a sum of positive terms, and `m1 x m2` comes from the
//! viewing ray, `(m1 x m2)_i = s_j s_k (n . r_i)` with `n = fx fy / z^2 (tx, ty, 1)` in camera axes: thin splats do not cancel.

use super::settings::{Settings, Splats};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::Real;

pub(super) type Vec3 = [f64; 3];

#[inline(always)]
pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A camera as the kernels use it.
#[derive(Clone, Debug)]
pub(super) struct Viewpoint {
    /// Rows of the world-to-camera rotation.
    axes: [Vec3; 3],
    center: Vec3,
    focal: [f64; 2],
    principal: [f64; 2],
    /// Image size, pixels.
    pub size: [usize; 2],
    /// Range of x/z and of y/z within which the Jacobian is taken.
    limits: [[f64; 2]; 2],
}

impl Viewpoint {
    pub fn new(camera: &Camera) -> Result<Self> {
        let bad = |field: &str, found: String, expected: &str| {
            Err(Error::config(format!("camera.{field}"), found, expected, "pass a usable camera"))
        };
        let Camera { rotation, center, fx, fy, cx, cy, width, height } = camera;
        if !rotation.is_finite() || !center.is_finite() {
            return bad("pose", format!("{rotation} {center}"), "finite numbers");
        }
        if !(fx.is_finite() && fy.is_finite() && *fx > 0.0 && *fy > 0.0) {
            return bad("fx, fy", format!("{fx}, {fy}"), "positive numbers");
        }
        if !(cx.is_finite() && cy.is_finite()) {
            return bad("cx, cy", format!("{cx}, {cy}"), "finite numbers");
        }
        if *width == 0 || *height == 0 || width.saturating_mul(*height) > u32::MAX as usize {
            return bad("width, height", format!("{width} x {height}"), "1 to 2^32 - 1 pixels");
        }
        let limits = |f: f64, c: f64, n: usize| [-(0.15 * n as f64 + c) / f, (1.15 * n as f64 - c) / f];
        Ok(Self {
            axes: rotation.transpose().to_cols_array_2d(),
            center: center.to_array(),
            focal: [*fx, *fy],
            principal: [*cx, *cy],
            size: [*width, *height],
            limits: [limits(*fx, *cx, *width), limits(*fy, *cy, *height)],
        })
    }

    /// Rows of the world-to-camera rotation.
    #[cfg(feature = "wgpu")]
    pub fn axes(&self) -> [Vec3; 3] {
        self.axes
    }

    /// Range of x/z and of y/z within which the Jacobian is taken.
    #[cfg(feature = "wgpu")]
    pub fn limits(&self) -> [[f64; 2]; 2] {
        self.limits
    }
}

/// One Gaussian in world space, in `f64`.
#[derive(Clone, Copy)]
pub(super) struct Splat3 {
    mean: Vec3,
    log_scale: Vec3,
    rotation: [f64; 4],
    logit: f64,
}

impl Splat3 {
    #[inline(always)]
    pub fn read<E: Real>(s: &Splats<'_, E>, i: usize) -> Self {
        let [m, l, q] = [&s.means[3 * i..3 * i + 3], &s.log_scales[3 * i..3 * i + 3], &s.rotations[4 * i..4 * i + 4]];
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
    let e = (-x.abs()).exp();
    if x >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

/// Squared length below which a quaternion is taken for the identity.
const ZERO_QUATERNION: f64 = 1e-12;

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
        let largest = raw.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let scaled = raw.map(|v| v / largest);
        let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt();
        let length = norm * largest;
        // 0 / 0 counts as zero too.
        if length.is_nan() || length * length < ZERO_QUATERNION {
            return Self { q: [1.0, 0.0, 0.0, 0.0], length: 1.0, zero: true };
        }
        Self { q: scaled.map(|v| v / norm), length, zero: false }
    }

    /// Columns of the rotation matrix.
    #[inline(always)]
    fn columns(&self) -> [Vec3; 3] {
        let [w, x, y, z] = self.q;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
            [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
            [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
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
struct Ewa {
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
    m: [Vec3; 2],
}

impl Ewa {
    #[inline(always)]
    fn new(s: &Splat3, v: &Viewpoint, p: Vec3) -> Self {
        let raw = [p[0] / p[2], p[1] / p[2]];
        let tangent: [f64; 2] = std::array::from_fn(|a| raw[a].clamp(v.limits[a][0], v.limits[a][1]));
        let inside = std::array::from_fn(|a| raw[a] > v.limits[a][0] && raw[a] < v.limits[a][1]);
        let jw: [Vec3; 2] = std::array::from_fn(|a| {
            let f = v.focal[a] / p[2];
            std::array::from_fn(|i| f * (v.axes[a][i] - tangent[a] * v.axes[2][i]))
        });
        let unit = Unit::new(s.rotation);
        let columns = unit.columns();
        let scale = s.log_scale.map(f64::exp);
        let m = std::array::from_fn(|a| std::array::from_fn(|i| scale[i] * dot(jw[a], columns[i])));
        Self { p, tangent, inside, jw, unit, columns, scale, m }
    }

    /// `|m1 x m2|^2` without cancellation.
    #[inline(always)]
    fn cross_squared(&self, v: &Viewpoint) -> f64 {
        let area = v.focal[0] * v.focal[1] / (self.p[2] * self.p[2]);
        let ray: Vec3 =
            std::array::from_fn(|i| self.tangent[0] * v.axes[0][i] + self.tangent[1] * v.axes[1][i] + v.axes[2][i]);
        let [a, b, c] = self.scale;
        let others = [b * c, a * c, a * b];
        (0..3).map(|i| (others[i] * area * dot(ray, self.columns[i])).powi(2)).sum()
    }
}

/// A projected Gaussian: pixel coordinates, shape of the ellipse, opacity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Ellipse {
    /// Centre, pixels.
    pub center: [f64; 2],
    /// `k = B / Y`.
    pub slope: f64,
    /// Variance of x given y, `det / Y`, pixels squared.
    pub s2: f64,
    /// Variance of y, `Y`, pixels squared.
    pub yy: f64,
    /// Natural logarithm of the opacity.
    pub log_opacity: f64,
    /// `u^2 + v^2` at which alpha' reaches alpha_min; infinite when alpha_min is 0.
    pub tau: f64,
    /// Camera z.
    pub depth: f64,
}

impl Ellipse {
    /// Variance of x.
    pub fn xx(&self) -> f64 {
        self.s2 + self.slope * self.slope * self.yy
    }

    /// `ceil(3 sqrt(lambda_max))`, at least 1.
    pub fn radius(&self) -> u32 {
        let (x, y, b) = (self.xx(), self.yy, self.slope * self.yy);
        let lambda = 0.5 * (x + y) + (0.25 * (x - y) * (x - y) + b * b).sqrt();
        ((3.0 * lambda.sqrt()).ceil() as u32).max(1)
    }
}

/// What becomes of a Gaussian in one view.
pub(super) enum Fate {
    Visible(Ellipse),
    Behind,
    OffScreen,
    NonFinite,
}

/// Whether a sphere around the Gaussian is off-screen: a cheap test that spares most of the work for most of a scene.
#[inline(always)]
fn far_off_screen(s: &Splat3, v: &Viewpoint, p: Vec3, settings: &Settings) -> bool {
    let largest = s.log_scale[0].max(s.log_scale[1]).max(s.log_scale[2]).exp();
    // ln(sigmoid(x)) is below both 0 and x.
    let tau = (s.logit.min(0.0) - settings.alpha_min.ln()).max(0.0);
    (0..2).any(|a| {
        let ratio = p[a] / p[2];
        let tangent = ratio.clamp(v.limits[a][0], v.limits[a][1]);
        let scale = largest * v.focal[a] / p[2];
        // A little more than the variance that the projection may have, for rounding.
        let variance = 1.001 * (scale * scale * (1.0 + tangent * tangent) + settings.low_pass);
        let (center, reach) = (v.focal[a] * ratio + v.principal[a], (2.0 * variance * tau).sqrt());
        // False where something overflowed: the projection is to find and count that.
        variance < 1e30 && (center + reach < -1.0 || center - reach > v.size[a] as f64 + 1.0)
    })
}

/// Projects one Gaussian; also says whether its quaternion was zero.
#[inline(always)]
pub(super) fn project<E: Real>(s: &Splat3, v: &Viewpoint, settings: &Settings) -> (Fate, bool) {
    let offset: Vec3 = std::array::from_fn(|i| s.mean[i] - v.center[i]);
    let p = v.axes.map(|axis| dot(axis, offset));
    if !(p[0].is_finite() && p[1].is_finite() && p[2].is_finite()) {
        return (Fate::NonFinite, false);
    }
    if p[2] <= settings.near {
        return (Fate::Behind, false);
    }
    if far_off_screen(s, v, p, settings) {
        let squares: f64 = s.rotation.iter().map(|q| q * q).sum();
        return (Fate::OffScreen, squares < ZERO_QUATERNION);
    }
    let ewa = Ewa::new(s, v, p);
    let zero = ewa.unit.zero;
    let low = settings.low_pass;
    let [m1, m2] = ewa.m;
    let (n1, n2) = (dot(m1, m1), dot(m2, m2));
    let yy = n2 + low;
    let slope = dot(m1, m2) / yy;
    let s2 = (ewa.cross_squared(v) + low * (n1 + n2) + low * low) / yy;
    // ln(sigmoid(x)) = -ln(1 + e^-x)
    let log_opacity = s.logit.min(0.0) - (-s.logit.abs()).exp().ln_1p();
    let center = [v.focal[0] * p[0] / p[2] + v.principal[0], v.focal[1] * p[1] / p[2] + v.principal[1]];
    // Infinite when alpha_min is 0.
    let tau = log_opacity - settings.alpha_min.ln();
    let ellipse = Ellipse { center, slope, s2, yy, log_opacity, tau, depth: p[2] };
    // What the kernels use must also be representable in their type.
    let fits = |x: f64| E::of(x).is_normal();
    let [du, dv] = [s2, yy].map(|v| (2.0 * v).sqrt().recip());
    let finite = [center[0], center[1], slope, ellipse.xx()].iter().all(|v| v.is_finite());
    if !finite || !fits(du) || !fits(dv) {
        return (Fate::NonFinite, zero);
    }
    if tau < 0.0 || log_opacity < f64::MIN_POSITIVE.ln() {
        return (Fate::OffScreen, zero);
    }
    let reach = [(2.0 * ellipse.xx() * tau).sqrt(), (2.0 * yy * tau).sqrt()];
    let out = |a: usize| center[a] + reach[a] < 0.0 || center[a] - reach[a] > v.size[a] as f64;
    if out(0) || out(1) {
        return (Fate::OffScreen, zero);
    }
    (Fate::Visible(ellipse), zero)
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

/// The derivative of [`project`] followed by the exponent, for a Gaussian that it called visible.
pub(super) fn project_backward(
    s: &Splat3,
    v: &Viewpoint,
    e: &super::footprint::Splat2,
    sums: &Moments,
    low_pass: f64,
) -> Gradient3 {
    let offset: Vec3 = std::array::from_fn(|i| s.mean[i] - v.center[i]);
    let p = v.axes.map(|axis| dot(axis, offset));
    let z = p[2];
    let ewa = Ewa::new(s, v, p);
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
        let d_m = [2.0 * d_xx * m1[i] + d_b * m2[i], 2.0 * d_yy * m2[i] + d_b * m1[i]];
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
        let d_tangent = if ewa.inside[a] { -f * dot(d_jw[a], v.axes[2]) } else { 0.0 };
        let d_ratio = d_tangent + v.focal[a] * center[a];
        d_p[a] += d_ratio / z;
        d_p[2] -= d_ratio * p[a] / (z * z);
    }
    let mean = std::array::from_fn(|i| (0..3).map(|a| v.axes[a][i] * d_p[a]).sum());
    Gradient3 { mean, log_scale, rotation: ewa.unit.backward(&d_columns), logit: sums.one * sigmoid(-s.logit), center }
}
