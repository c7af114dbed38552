//! View-dependent colour: real spherical harmonics in the 3DGS sign and order, and their derivative.

use super::geometry::{Vec3, dot};
use crate::backend::simd::wide_kernel;
use crate::backend::{Real, check_finite};
use crate::error::Result;
use crate::splat::sh::{C1, C2, C3, basis};
use rayon::prelude::*;

/// Gaussians that one task handles.
const CHUNK: usize = 1024;

/// Gradient of `sum_k g[k] basis[k]` with respect to the direction, components taken as independent.
#[inline(always)]
fn basis_backward([x, y, z]: Vec3, degree: usize, g: &[f64; 16]) -> Vec3 {
    let mut d = [0.0; 3];
    if degree > 0 {
        d = [-C1 * g[3], -C1 * g[1], C1 * g[2]];
    }
    if degree > 1 {
        let [a, b, c, e, f] = std::array::from_fn(|i| C2[i] * g[4 + i]);
        d[0] += a * y - 2.0 * c * x + e * z + 2.0 * f * x;
        d[1] += a * x + b * z - 2.0 * c * y - 2.0 * f * y;
        d[2] += b * y + 4.0 * c * z + e * x;
    }
    if degree > 2 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let k: [f64; 7] = std::array::from_fn(|i| C3[i] * g[9 + i]);
        d[0] += 6.0 * k[0] * x * y + k[1] * y * z - 2.0 * k[2] * x * y - 6.0 * k[3] * x * z
            + k[4] * (4.0 * zz - 3.0 * xx - yy)
            + 2.0 * k[5] * x * z
            + 3.0 * k[6] * (xx - yy);
        d[1] += 3.0 * k[0] * (xx - yy) + k[1] * x * z + k[2] * (4.0 * zz - xx - 3.0 * yy)
            - 6.0 * k[3] * y * z
            - 2.0 * k[4] * x * y
            - 2.0 * k[5] * y * z
            - 6.0 * k[6] * x * y;
        d[2] += k[1] * x * y
            + 8.0 * k[2] * y * z
            + k[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy)
            + 8.0 * k[4] * x * z
            + k[5] * (xx - yy);
    }
    d
}

/// Unit direction from `center` to row `i` of `means`, and the distance; both zero where they coincide.
#[inline(always)]
fn direction<E: Real>(means: &[E], i: usize, center: Vec3) -> (Vec3, f64) {
    let v: Vec3 = std::array::from_fn(|a| means[3 * i + a].wide() - center[a]);
    let length = dot(v, v).sqrt();
    if length > 0.0 {
        (v.map(|v| v / length), length)
    } else {
        ([0.0; 3], 0.0)
    }
}

/// Colours `max(0, SH(direction) + 0.5)`, `[N, 3]`, of rows with a nonzero entry in `wanted`; other rows are 0.
///
/// `means` is `[N, 3]`, `sh` `[N, K, 3]` with `K = (sh_degree + 1)^2`; terms above `active_degree` are left out; the
/// direction runs from the camera centre to the mean.
///
/// # Errors
/// [`crate::Error::NonFinite`] for a NaN or an infinity in `sh`, wanted or not.
///
/// # Panics
/// If the lengths disagree, or a degree is above 3.
pub(in crate::raster) fn visible_colours<E: Real>(
    means: &[E],
    sh: &[E],
    sh_degree: usize,
    active_degree: usize,
    center: Vec3,
    wanted: &[u32],
) -> Result<Vec<E>> {
    let rows = Coefficients::new(means, sh, sh_degree, active_degree, center);
    let mut out = vec![E::zero(); means.len()];
    // Coefficients are most of a scene's memory: each is checked and used while it is in the cache.
    let finite = out
        .par_chunks_mut(3 * CHUNK)
        .zip(wanted.par_chunks(CHUNK))
        .enumerate()
        .map(|(chunk, (out, wanted))| {
            evaluate(&rows, chunk * CHUNK, wanted, out);
            rows.are_finite(chunk * CHUNK, wanted.len())
        });
    // All chunks are checked, so that the result does not depend on which thread comes first.
    if !finite.reduce(|| true, |a, b| a & b) {
        check_finite("sh", sh, rows.width)?;
    }
    Ok(out)
}

/// Spherical harmonics of Gaussians seen from a point.
struct Coefficients<'a, E> {
    means: &'a [E],
    sh: &'a [E],
    /// Values a Gaussian.
    width: usize,
    degree: usize,
    center: Vec3,
}

impl<'a, E: Real> Coefficients<'a, E> {
    fn new(
        means: &'a [E],
        sh: &'a [E],
        sh_degree: usize,
        active_degree: usize,
        center: Vec3,
    ) -> Self {
        let width = 3 * (sh_degree + 1).pow(2);
        assert!(sh_degree <= 3, "colours: degree {sh_degree} above 3");
        assert_eq!(
            means.len() * width,
            sh.len() * 3,
            "colours: means against SH coefficients"
        );
        Self {
            means,
            sh,
            width,
            degree: active_degree.min(sh_degree),
            center,
        }
    }

    /// Whether those of `count` Gaussians from `first` on are finite.
    fn are_finite(&self, first: usize, count: usize) -> bool {
        // Counting vectorises where stopping at the first would not.
        let own = &self.sh[first * self.width..(first + count) * self.width];
        own.iter().map(|v| u32::from(!v.is_finite())).sum::<u32>() == 0
    }
}

wide_kernel! {
    /// Colours of the Gaussians from `first` on, one for each of `wanted`, where that is not 0.
    fn evaluate(rows: &Coefficients<'_, E>, first: usize, wanted: &[u32], out: &mut [E]) => evaluate_all
}

#[inline(always)]
fn evaluate_all<E: Real, const _FMA: bool>(
    rows: &Coefficients<'_, E>,
    first: usize,
    wanted: &[u32],
    out: &mut [E],
) {
    let terms = (rows.degree + 1).pow(2);
    for ((out, i), &wanted) in out.chunks_exact_mut(3).zip(first..).zip(wanted) {
        if wanted == 0 {
            continue;
        }
        let (d, _) = direction(rows.means, i, rows.center);
        let basis = basis(d, rows.degree);
        let mut sum = [E::of(0.5); 3];
        for (b, sh) in basis[..terms]
            .iter()
            .zip(rows.sh[i * rows.width..].chunks_exact(3))
        {
            let b = E::of(*b);
            for c in 0..3 {
                sum[c] += b * sh[c];
            }
        }
        out.copy_from_slice(&sum.map(|v| v.max(E::zero())));
    }
}

/// The inputs of the backward pass of the colours.
pub(in crate::raster) struct ShBackward<'a, E> {
    /// `[N, 3]`.
    pub means: &'a [E],
    /// `[N, K, 3]`.
    pub sh: &'a [E],
    pub sh_degree: usize,
    pub active_degree: usize,
    pub center: Vec3,
    /// Colours as [`visible_colours`] gave them, rows of `stride` values.
    pub colours: &'a [E],
    /// Their gradient, rows of `stride` values.
    pub gradient: &'a [E],
    pub stride: usize,
    /// Rows with 0 here have no gradient.
    pub wanted: &'a [u32],
}

impl<E: Real> ShBackward<'_, E> {
    /// Gradient of the SH coefficients, `[N, K, 3]`; that of the means is added to `d_means`, `[N, 3]`.
    pub fn run(&self, d_means: &mut [E]) -> Vec<E> {
        let width = 3 * (self.sh_degree + 1).pow(2);
        let degree = self.active_degree.min(self.sh_degree);
        let terms = (degree + 1).pow(2);
        let mut d_sh = vec![E::zero(); self.sh.len()];
        d_sh.par_chunks_mut(width * CHUNK)
            .zip(d_means.par_chunks_mut(3 * CHUNK))
            .enumerate()
            .for_each(|(chunk, (d_sh, d_means))| {
                let rows = d_sh
                    .chunks_exact_mut(width)
                    .zip(d_means.chunks_exact_mut(3));
                for ((d_sh, d_mean), i) in rows.zip(chunk * CHUNK..) {
                    if self.wanted[i] == 0 {
                        continue;
                    }
                    let at = i * self.stride;
                    // The colour is 0 where max(0, .) cut it off.
                    let g: [E; 3] = std::array::from_fn(|c| {
                        if self.colours[at + c] > E::zero() {
                            self.gradient[at + c]
                        } else {
                            E::zero()
                        }
                    });
                    let (d, length) = direction(self.means, i, self.center);
                    let basis = basis(d, degree);
                    let mut d_basis = [0.0; 16];
                    let sh = &self.sh[i * width..];
                    for k in 0..terms {
                        let b = E::of(basis[k]);
                        let mut sum = E::zero();
                        for c in 0..3 {
                            d_sh[3 * k + c] = b * g[c];
                            sum += sh[3 * k + c] * g[c];
                        }
                        d_basis[k] = sum.wide();
                    }
                    if degree > 0 && length > 0.0 {
                        let d_direction = basis_backward(d, degree, &d_basis);
                        let along = dot(d, d_direction);
                        for a in 0..3 {
                            d_mean[a] += E::of((d_direction[a] - d[a] * along) / length);
                        }
                    }
                }
            });
        d_sh
    }
}
