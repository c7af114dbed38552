//! View-dependent colour: real spherical harmonics in the 3DGS sign and order, and their derivative.

use super::geometry::{Vec3, dot};
use crate::backend::simd::wide_kernel;
use crate::backend::{Real, check_finite};
use crate::error::Result;
use crate::splat::camera::Camera;
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

/// Spherical harmonics of Gaussians seen from a point.
pub(in crate::raster) struct Harmonics<'a, E> {
    means: &'a [E],
    sh: &'a [E],
    /// Values a Gaussian.
    width: usize,
    degree: usize,
    center: Vec3,
}

impl<'a, E: Real> Harmonics<'a, E> {
    /// `means` is `[N, 3]`, `sh` `[N, K, 3]` with `K = (sh_degree + 1)^2`; terms above `active_degree` are left out; the
    /// direction runs from the camera centre to the mean.
    ///
    /// # Panics
    /// If the lengths disagree, or `sh_degree` is above 3.
    pub fn new(
        means: &'a [E],
        sh: &'a [E],
        sh_degree: usize,
        active_degree: usize,
        camera: &Camera,
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
            center: camera.center.to_array(),
        }
    }

    /// Colours `max(0, SH(direction) + 0.5)`, `[N, 3]`, of rows with a nonzero entry in `wanted`; other rows are 0.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] for a NaN or an infinity among the coefficients, wanted or not.
    pub fn colours(&self, wanted: &[u32]) -> Result<Vec<E>> {
        let mut out = vec![E::zero(); self.means.len()];
        // Coefficients are most of a scene's memory: each is checked and used while it is in the cache.
        let finite = out
            .par_chunks_mut(3 * CHUNK)
            .zip(wanted.par_chunks(CHUNK))
            .enumerate()
            .map(|(chunk, (out, wanted))| {
                evaluate(self, chunk * CHUNK, wanted, out);
                self.are_finite(chunk * CHUNK, wanted.len())
            });
        // All chunks are checked, so that the result does not depend on which thread comes first.
        if !finite.reduce(|| true, |a, b| a & b) {
            check_finite("sh", self.sh, self.width)?;
        }
        Ok(out)
    }

    /// Whether those of `count` Gaussians from `first` on are finite.
    fn are_finite(&self, first: usize, count: usize) -> bool {
        // Counting vectorises where stopping at the first would not.
        let own = &self.sh[first * self.width..(first + count) * self.width];
        own.iter().map(|v| u32::from(!v.is_finite())).sum::<u32>() == 0
    }

    /// Gradient of the coefficients, `[N, K, 3]`, by that of the colours; that of the means is added to `d_means`, `[N, 3]`.
    ///
    /// `colours` are those of [`Harmonics::colours`] and `gradient` is theirs, both in rows of `stride` values. Rows with 0 in
    /// `wanted` have no gradient.
    pub fn backward(
        &self,
        colours: &[E],
        gradient: &[E],
        stride: usize,
        wanted: &[u32],
        d_means: &mut [E],
    ) -> Vec<E> {
        let mut d_sh = vec![E::zero(); self.sh.len()];
        d_sh.par_chunks_mut(self.width * CHUNK)
            .zip(d_means.par_chunks_mut(3 * CHUNK))
            .enumerate()
            .for_each(|(chunk, (d_sh, d_means))| {
                let rows = d_sh
                    .chunks_exact_mut(self.width)
                    .zip(d_means.chunks_exact_mut(3));
                for ((d_sh, d_mean), i) in rows.zip(chunk * CHUNK..) {
                    if wanted[i] == 0 {
                        continue;
                    }
                    let at = i * stride;
                    // The colour is 0 where max(0, .) cut it off.
                    let g: [E; 3] = std::array::from_fn(|c| {
                        if colours[at + c] > E::zero() {
                            gradient[at + c]
                        } else {
                            E::zero()
                        }
                    });
                    self.row_backward(i, g, d_sh, d_mean);
                }
            });
        d_sh
    }

    /// Gradients of Gaussian `i` by that of its colour, `g`.
    #[inline(always)]
    fn row_backward(&self, i: usize, g: [E; 3], d_sh: &mut [E], d_mean: &mut [E]) {
        let (d, length) = direction(self.means, i, self.center);
        let basis = basis(d, self.degree);
        let mut d_basis = [0.0; 16];
        let sh = &self.sh[i * self.width..];
        for k in 0..(self.degree + 1).pow(2) {
            let b = E::of(basis[k]);
            let mut sum = E::zero();
            for c in 0..3 {
                d_sh[3 * k + c] = b * g[c];
                sum += sh[3 * k + c] * g[c];
            }
            d_basis[k] = sum.wide();
        }
        if self.degree > 0 && length > 0.0 {
            let d_direction = basis_backward(d, self.degree, &d_basis);
            let along = dot(d, d_direction);
            for a in 0..3 {
                d_mean[a] += E::of((d_direction[a] - d[a] * along) / length);
            }
        }
    }
}

wide_kernel! {
    /// Colours of the Gaussians from `first` on, one for each of `wanted`, where that is not 0.
    fn evaluate(harmonics: &Harmonics<'_, E>, first: usize, wanted: &[u32], out: &mut [E]) => evaluate_all
}

#[inline(always)]
fn evaluate_all<E: Real, const _FMA: bool>(
    harmonics: &Harmonics<'_, E>,
    first: usize,
    wanted: &[u32],
    out: &mut [E],
) {
    let terms = (harmonics.degree + 1).pow(2);
    for ((out, i), &wanted) in out.chunks_exact_mut(3).zip(first..).zip(wanted) {
        if wanted == 0 {
            continue;
        }
        let (d, _) = direction(harmonics.means, i, harmonics.center);
        let basis = basis(d, harmonics.degree);
        let mut sum = [E::of(0.5); 3];
        for (b, sh) in basis[..terms]
            .iter()
            .zip(harmonics.sh[i * harmonics.width..].chunks_exact(3))
        {
            let b = E::of(*b);
            for c in 0..3 {
                sum[c] += b * sh[c];
            }
        }
        out.copy_from_slice(&sum.map(|v| v.max(E::zero())));
    }
}
