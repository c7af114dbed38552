//! Sums over the pixels of a Gaussian, of which the gradient of its geometry is made.

use super::footprint::{Splat2, UNIT};
use crate::backend::Real;
use crate::backend::simd::Lanes;

/// Moments of a Gaussian.
pub(super) const MOMENTS: usize = 6;

/// Sums of `g = dL/dalpha' alpha'` times 1, u, v, u^2, u v, v^2. With `ABSOLUTE` also, negated, the sums of each pixel's absolute
/// contribution to the gradient of the centre.
pub(super) struct Moments<E, S: Lanes<E>, const ABSOLUTE: bool> {
    s: S,
    pub moments: [S::V; MOMENTS],
    pub minus_absolute: [S::V; 2],
    /// [`drift`].
    drift: [S::V; 3],
}

impl<E: Real, S: Lanes<E>, const ABSOLUTE: bool> Moments<E, S, ABSOLUTE> {
    /// No pixels yet. `drift` is that of the Gaussian; without `ABSOLUTE` nothing reads it.
    #[inline(always)]
    pub fn new(s: S, drift: [E; 3]) -> Self {
        let zero = s.splat(E::zero());
        Self {
            s,
            moments: [zero; MOMENTS],
            minus_absolute: [zero; 2],
            drift: drift.map(|drift| s.splat(drift)),
        }
    }

    /// Adds a register of pixels.
    #[inline(always)]
    pub fn add(&mut self, g: S::V, u: S::V, v: S::V) {
        let s = self.s;
        let gu = s.mul(g, u);
        let gv = s.mul(g, v);
        let [one, m_u, m_v, m_uu, m_uv, m_vv] = &mut self.moments;
        *one = s.add(*one, g);
        *m_u = s.add(*m_u, gu);
        *m_v = s.add(*m_v, gv);
        *m_uu = s.mul_add(gu, u, *m_uu);
        *m_uv = s.mul_add(gu, v, *m_uv);
        *m_vv = s.mul_add(gv, v, *m_vv);
        if ABSOLUTE {
            let [u_x, u_y, v_y] = self.drift;
            let [x, y] = &mut self.minus_absolute;
            *x = s.add(*x, s.minus_abs(s.mul(gu, u_x)));
            *y = s.add(*y, s.minus_abs(s.mul_add(gv, v_y, s.mul(gu, u_y))));
        }
    }
}

/// Change of the kernels' `u` and `v` as the centre moves by a pixel: `u` along x, `u` along y, `v` along y.
#[inline(always)]
pub(super) fn drift<E: Real>(splat: &Splat2) -> [E; 3] {
    [
        UNIT * splat.du,
        -UNIT * splat.du * splat.slope,
        UNIT * splat.dv,
    ]
    .map(E::of)
}
