//! Which pixels of a tile a projected Gaussian reaches, and its alpha' there.

use super::geometry::Ellipse;
use crate::ops::Real;
use crate::ops::vector::{LANES, Vector};

/// Pixels along a tile's edge.
pub(super) const TILE: usize = 16;
/// Length of a row of a tile's buffers: vectors start anywhere in a row and may run past its end.
pub(super) const STRIDE: usize = TILE + LANES;
/// Length of a tile's buffers.
pub(super) const BUFFER: usize = TILE * STRIDE;

/// A projected Gaussian as the tile kernels read it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Splat2 {
    /// Centre, pixels.
    pub center: [f64; 2],
    /// `B / Y`: how far the middle of a row moves per row.
    pub slope: f64,
    /// `u` per pixel along x, `1 / sqrt(2 s2)`.
    pub du: f64,
    /// `v` per pixel along y, `1 / sqrt(2 Y)`.
    pub dv: f64,
    /// Largest `sqrt(u^2 + v^2)` that contributes, with a margin for rounding; infinite when alpha_min is 0.
    pub reach: f64,
    /// In 0..=1.
    pub opacity: f64,
}

impl From<&Ellipse> for Splat2 {
    fn from(e: &Ellipse) -> Self {
        Self {
            center: e.center,
            slope: e.slope,
            du: (2.0 * e.s2).sqrt().recip(),
            dv: (2.0 * e.yy).sqrt().recip(),
            reach: (e.tau + 1e-3).sqrt(),
            opacity: e.opacity,
        }
    }
}

/// One Gaussian over one tile: the rows it covers, and `u`, `v` there.
pub(super) struct Footprint<E> {
    /// First and one past the last row.
    pub rows: [usize; 2],
    /// `u` at column 0 of the first row, and its steps along a row and from row to row.
    u: E,
    pub du: E,
    du_row: E,
    /// `v` at the first row, and its step.
    v: E,
    dv: E,
    reach2: E,
    inverse_du: E,
    pub opacity: E,
}

/// `x` rounded to an integer in `0..=limit` by `as`, which saturates.
#[inline(always)]
fn clip(x: f64, limit: usize) -> usize {
    (x.max(0.0) as usize).min(limit)
}

impl<E: Real> Footprint<E> {
    /// Of `s` over the tile whose first pixel is `origin`.
    #[inline(always)]
    pub fn new(s: &Splat2, origin: [usize; 2]) -> Self {
        // In f64 from the tile's corner on: a huge splat centred far away would lose its edge in f32.
        let x = origin[0] as f64 + 0.5 - s.center[0];
        let y = origin[1] as f64 + 0.5 - s.center[1];
        let half = s.reach / s.dv;
        let first = clip((-half - y).ceil(), TILE);
        let last = clip((half - y).floor() + 1.0, TILE);
        let y = y + first as f64;
        Self {
            rows: [first, last],
            u: E::of(s.du * (x - s.slope * y)),
            du: E::of(s.du),
            du_row: E::of(-s.du * s.slope),
            v: E::of(s.dv * y),
            dv: E::of(s.dv),
            reach2: E::of(s.reach * s.reach),
            inverse_du: E::of(s.du.recip()),
            opacity: E::of(s.opacity),
        }
    }

    /// `u` at column 0 and `v` of row `row`.
    #[inline(always)]
    pub fn row(&self, row: usize) -> (E, E) {
        let step = E::of((row - self.rows[0]) as f64);
        (self.u + step * self.du_row, self.v + step * self.dv)
    }

    /// First and one past the last column that the ellipse may cover in a row with these `u`, `v`.
    #[inline(always)]
    pub fn span(&self, u: E, v: E) -> [usize; 2] {
        let rest = self.reach2 - v * v;
        if rest.is_nan() || rest < E::zero() {
            return [0, 0];
        }
        let middle = -u * self.inverse_du;
        let half = rest.sqrt() * self.inverse_du;
        let first = clip((middle - half).wide().ceil(), TILE);
        let last = clip((middle + half).wide().floor() + 1.0, TILE);
        [first, last]
    }
}

/// What a kernel does with the vectors of pixels that a Gaussian covers.
pub(super) trait Visit<E, V> {
    /// `LANES` pixels from buffer position `at` on.
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>);
}

/// A Gaussian's exponent and alpha' at `LANES` pixels of a row.
pub(super) struct Lanes<E, V> {
    pub u: V,
    /// The same in all lanes.
    pub v: E,
    /// 0 below the cut-off.
    pub alpha: V,
}

/// Shows `visitor` every vector of pixels that `footprint` covers, in rows whose bit in `live` is set.
#[inline(always)]
pub(super) fn walk<E: Real, V: Vector<E>>(
    footprint: &Footprint<E>,
    rule: &Rule<V>,
    live: u32,
    visitor: &mut impl Visit<E, V>,
) {
    let du = V::splat(footprint.du);
    let opacity = V::splat(footprint.opacity);
    for row in footprint.rows[0]..footprint.rows[1] {
        if live >> row & 1 == 0 {
            continue;
        }
        let (u0, v) = footprint.row(row);
        let [first, last] = footprint.span(u0, v);
        let minus_vv = V::splat(-(v * v));
        let mut x = first;
        while x < last {
            let u = V::ramp().fma(du, V::splat(u0 + E::of(x as f64) * footprint.du));
            let alpha = rule.cut(opacity.mul(u.fnma(u, minus_vv).exp_nonpositive()));
            visitor.visit(row * STRIDE + x, &Lanes { u, v, alpha });
            x += LANES;
        }
    }
}

/// Constants of the blending rule.
#[derive(Clone, Copy)]
pub(super) struct Rule<V> {
    alpha_max: V,
    alpha_min: V,
    t_min: V,
    zero: V,
    one: V,
}

impl<V> Rule<V> {
    #[inline(always)]
    pub fn new<E: Real>(s: &super::Settings) -> Self
    where
        V: Vector<E>,
    {
        let splat = |x: f64| V::splat(E::of(x));
        let [alpha_max, alpha_min, t_min] = [s.alpha_max, s.alpha_min, s.t_min].map(splat);
        Self { alpha_max, alpha_min, t_min, zero: splat(0.0), one: splat(1.0) }
    }

    /// The cap and the cut-off.
    #[inline(always)]
    fn cut<E>(&self, alpha: V) -> V
    where
        V: Vector<E>,
    {
        let alpha = alpha.min(self.alpha_max);
        self.alpha_min.select_above(alpha, self.zero, alpha)
    }

    /// Weights `alpha' T`; updates `t`. A pixel that ends keeps its transmittance with the sign turned, which also stops
    /// it from taking anything more; `alpha` becomes 0 there.
    #[inline(always)]
    pub fn absorb<E>(&self, alpha: &mut V, t: &mut V) -> V
    where
        V: Vector<E>,
    {
        let next = alpha.fnma(*t, *t);
        let ended = self.zero.sub(t.abs());
        *alpha = next.select_above(self.t_min, *alpha, self.zero);
        let weight = alpha.mul(*t);
        *t = next.select_above(self.t_min, next, ended);
        weight
    }

    /// `g` where alpha' is below the cap, else 0.
    #[inline(always)]
    pub fn below_cap<E>(&self, alpha: V, g: V) -> V
    where
        V: Vector<E>,
    {
        self.alpha_max.select_above(alpha, g, self.zero)
    }

    /// 1 in all lanes.
    pub fn one(&self) -> V
    where
        V: Copy,
    {
        self.one
    }
}

/// Transmittance of a tile's pixels: 1 inside an image of `size`, ended outside and in the margin.
#[inline(always)]
pub(super) fn fresh_transmittance<E: Real>(origin: [usize; 2], size: [usize; 2]) -> [E; BUFFER] {
    let mut t = [-E::one(); BUFFER];
    let [w, h] = [(size[0] - origin[0]).min(TILE), (size[1] - origin[1]).min(TILE)];
    for row in t.chunks_exact_mut(STRIDE).take(h) {
        row[..w].fill(E::one());
    }
    t
}

/// A bit for every row that still has a pixel which takes more.
#[inline(always)]
pub(super) fn live_rows<E: Real>(t: &[E; BUFFER]) -> u32 {
    let mut live = 0;
    for (row, t) in t.chunks_exact(STRIDE).enumerate() {
        let mut top = -E::one();
        for &t in &t[..TILE] {
            top = if t > top { t } else { top };
        }
        live |= u32::from(top > E::zero()) << row;
    }
    live
}

/// `LANES` values of a tile's buffer from `at` on.
#[inline(always)]
pub(super) fn load<E: Real, V: Vector<E>>(buffer: &[E; BUFFER], at: usize) -> V {
    buffer[at..].first_chunk().map_or_else(|| V::splat(E::zero()), V::load)
}

/// Stores `LANES` values into a tile's buffer.
#[inline(always)]
pub(super) fn store<E: Real, V: Vector<E>>(buffer: &mut [E; BUFFER], at: usize, values: V) {
    if let Some(chunk) = buffer[at..].first_chunk_mut() {
        values.store(chunk);
    }
}
