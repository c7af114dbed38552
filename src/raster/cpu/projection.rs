//! Projection of many Gaussians, in `f64`: loops without branches over columns of values, which become vectors.
//!
//! Nothing is fused: the depth order and the tile lists do not depend on the instruction set. They do not depend on `E` either,
//! except where `E` cannot hold a number.
//! A cheap test first removes Gaussians that are certainly outside the image. The others are projected in full.

use super::footprint::Splat2;
use super::geometry::{Ewa, Splat3, Viewpoint, dot};
use crate::backend::Real;
use crate::backend::elementary::{exp, ln_1p_unit};
use crate::backend::simd::wide_kernel;
use crate::raster::settings::{Settings, Splats};

/// Gaussians of one loop.
const BLOCK: usize = 32;
/// A value of each.
type Column = [f64; BLOCK];

/// A Gaussian that is not culled.
#[derive(Clone, Copy)]
pub(super) struct Visible {
    /// Camera z.
    pub depth: f64,
    /// Index in the scene.
    pub id: u32,
    pub splat: Splat2,
}

/// Constants of one view.
#[derive(Clone, Copy)]
struct View {
    point: Viewpoint,
    near: f64,
    low_pass: f64,
    /// `ln alpha_min`.
    ln_alpha_min: f64,
}

wide_kernel! {
    /// Projects the Gaussians from `first` on, one for each of `radii`; gives the visible ones in order. `radii` are zero before;
    /// those of culled Gaussians stay zero.
    pub(super) fn project(
        splats: &Splats<'_, E>, first: usize, viewpoint: &Viewpoint, settings: &Settings,
        radii: &mut [u32],
    ) -> Vec<Visible> => project_all
}

#[inline(always)]
fn project_all<E: Real, const _FMA: bool>(
    splats: &Splats<'_, E>,
    first: usize,
    viewpoint: &Viewpoint,
    settings: &Settings,
    radii: &mut [u32],
) -> Vec<Visible> {
    let view = View {
        point: *viewpoint,
        near: settings.near,
        low_pass: settings.low_pass,
        ln_alpha_min: settings.alpha_min.ln(),
    };
    let mut in_sight = Vec::with_capacity(radii.len());
    for start in (0..radii.len()).step_by(BLOCK) {
        let ids = first + start..first + radii.len().min(start + BLOCK);
        let sifted = sift(splats, ids.start, ids.len(), &view);
        in_sight.extend(
            ids.zip(sifted)
                .filter(|(_, seen)| *seen != 0)
                .map(|(id, _)| id),
        );
    }
    let mut visible = Vec::with_capacity(radii.len());
    for ids in in_sight.chunks(BLOCK) {
        let block = Block::new(splats, ids, &view);
        for (l, &id) in ids.iter().enumerate() {
            if block.is_visible::<E>(l, &view) {
                radii[id - first] = block.radius(l);
                visible.push(Visible {
                    depth: block.depth[l],
                    id: id as u32,
                    splat: block.splat(l),
                });
            }
        }
    }
    visible
}

/// The cheap test of the Gaussians `first..first + len`: a sphere around each one against the image. 0 where a Gaussian is
/// certainly outside or not finite, else 1. The flags are as wide as `f64`, so that loops over both become vectors.
#[inline(always)]
fn sift<E: Real>(splats: &Splats<'_, E>, first: usize, len: usize, view: &View) -> [u64; BLOCK] {
    let mut mean = [[0.0; BLOCK]; 3];
    let mut log_scale = [0.0; BLOCK];
    let mut logit = [0.0; BLOCK];
    let rows = splats.means[3 * first..]
        .chunks_exact(3)
        .zip(splats.log_scales[3 * first..].chunks_exact(3));
    for (l, ((m, s), o)) in rows
        .zip(&splats.opacity_logits[first..])
        .take(len)
        .enumerate()
    {
        for (column, &value) in mean.iter_mut().zip(m) {
            column[l] = value.wide();
        }
        log_scale[l] = s[0].max(s[1]).max(s[2]).wide();
        logit[l] = o.wide();
    }
    let View {
        point: v,
        near,
        low_pass,
        ln_alpha_min,
    } = *view;
    let mut seen = [0; BLOCK];
    for l in 0..BLOCK {
        let p = v.to_camera([mean[0][l], mean[1][l], mean[2][l]]);
        let largest = exp(log_scale[l]);
        // ln(sigmoid(x)) is below both 0 and x.
        let tau = (logit[l].min(0.0) - ln_alpha_min).max(0.0);
        let mut out = false;
        for a in 0..2 {
            let ratio = p[a] / p[2];
            let tangent = ratio.max(v.limits[a][0]).min(v.limits[a][1]);
            let scale = largest * (v.focal[a] / p[2]);
            // A little more than the variance that the projection may have, for rounding.
            let variance = 1.001 * (scale * scale * (1.0 + tangent * tangent) + low_pass);
            let center = v.focal[a] * ratio + v.principal[a];
            let reach = (2.0 * variance * tau).sqrt();
            // False where something overflowed: the projection decides that case.
            out |= (variance < 1e30)
                & ((center + reach < -1.0) | (center - reach > v.size[a] as f64 + 1.0));
        }
        let finite = (p[0].abs() < f64::INFINITY)
            & (p[1].abs() < f64::INFINITY)
            & (p[2].abs() < f64::INFINITY);
        seen[l] = u64::from(finite & (p[2] > near) & !out);
    }
    seen
}

/// Projected Gaussians, a column for each value; [`Splat2`] says what they are.
#[derive(Default)]
struct Block {
    center: [Column; 2],
    slope: Column,
    du: Column,
    dv: Column,
    log_opacity: Column,
    /// `u^2 + v^2` at which alpha' reaches alpha_min.
    tau: Column,
    /// Half the bounding box of the alpha_min ellipse, pixels.
    reach: [Column; 2],
    /// Variance of x, pixels squared.
    xx: Column,
    /// Larger eigenvalue of the covariance, pixels squared.
    lambda: Column,
    depth: Column,
}

impl Block {
    /// Projects the Gaussians `ids`, at most [`BLOCK`].
    #[inline(always)]
    fn new<E: Real>(splats: &Splats<'_, E>, ids: &[usize], view: &View) -> Self {
        let none = [0.0; BLOCK];
        let (mut mean, mut log_scale, mut rotation, mut logit) =
            ([none; 3], [none; 3], [none; 4], none);
        for (l, &id) in ids.iter().enumerate() {
            let s = Splat3::read(splats, id);
            for i in 0..3 {
                (mean[i][l], log_scale[i][l]) = (s.mean[i], s.log_scale[i]);
            }
            for (column, value) in rotation.iter_mut().zip(s.rotation) {
                column[l] = value;
            }
            logit[l] = s.logit;
        }
        let View {
            point: v,
            low_pass: low,
            ln_alpha_min,
            ..
        } = *view;
        let mut out = Self::default();
        for l in 0..BLOCK {
            let p = v.to_camera([mean[0][l], mean[1][l], mean[2][l]]);
            let scale = [
                exp(log_scale[0][l]),
                exp(log_scale[1][l]),
                exp(log_scale[2][l]),
            ];
            let ewa = Ewa::new(
                [
                    rotation[0][l],
                    rotation[1][l],
                    rotation[2][l],
                    rotation[3][l],
                ],
                scale,
                &v,
                p,
            );
            let [m1, m2] = ewa.m;
            let n1 = dot(m1, m1);
            let n2 = dot(m2, m2);
            let yy = n2 + low;
            let slope = dot(m1, m2) / yy;
            let s2 = (ewa.cross_squared(&v) + low * (n1 + n2) + low * low) / yy;
            let xx = s2 + slope * slope * yy;
            // ln(sigmoid(x)) = -ln(1 + e^-x)
            let log_opacity = logit[l].min(0.0) - ln_1p_unit(exp(-logit[l].abs()));
            let tau = log_opacity - ln_alpha_min;
            let half = 0.5 * (xx - yy);
            let b = slope * yy;
            for a in 0..2 {
                out.center[a][l] = v.focal[a] * (p[a] / p[2]) + v.principal[a];
            }
            out.slope[l] = slope;
            out.du[l] = 1.0 / (2.0 * s2).sqrt();
            out.dv[l] = 1.0 / (2.0 * yy).sqrt();
            out.log_opacity[l] = log_opacity;
            out.tau[l] = tau;
            out.reach[0][l] = (2.0 * xx * tau).sqrt();
            out.reach[1][l] = (2.0 * yy * tau).sqrt();
            out.xx[l] = xx;
            out.lambda[l] = 0.5 * (xx + yy) + (half * half + b * b).sqrt();
            out.depth[l] = p[2];
        }
        out
    }

    /// Whether Gaussian `l` is in the image and what the kernels use of it is finite, in their type too.
    #[inline(always)]
    fn is_visible<E: Real>(&self, l: usize, view: &View) -> bool {
        let fits = |x: f64| E::of(x).is_normal();
        let finite = [
            self.center[0][l],
            self.center[1][l],
            self.slope[l],
            self.xx[l],
        ]
        .iter()
        .all(|v| v.is_finite());
        let out = |a: usize| {
            let center = self.center[a][l];
            let reach = self.reach[a][l];
            center + reach < 0.0 || center - reach > view.point.size[a] as f64
        };
        // The logarithm of the smallest normal `f64`.
        let nothing = self.tau[l] < 0.0 || self.log_opacity[l] < -708.396_418_532_264_1;
        finite && fits(self.du[l]) && fits(self.dv[l]) && !nothing && !out(0) && !out(1)
    }

    /// `ceil(3 sqrt(lambda_max))`, at least 1.
    #[inline(always)]
    fn radius(&self, l: usize) -> u32 {
        ((3.0 * self.lambda[l].sqrt()).ceil() as u32).max(1)
    }

    #[inline(always)]
    fn splat(&self, l: usize) -> Splat2 {
        Splat2 {
            center: [self.center[0][l], self.center[1][l]],
            slope: self.slope[l],
            du: self.du[l],
            dv: self.dv[l],
            reach: (self.tau[l] + 1e-3).sqrt(),
            log_opacity: self.log_opacity[l],
        }
    }
}
