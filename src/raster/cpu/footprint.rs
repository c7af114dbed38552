//! Which pixels of a tile a projected Gaussian reaches, and its alpha' there.
//!
//! A tile is cut into strips of `LANES` neighbouring pixels of a row. Strips are fixed in place: a kernel's state lies
//! in aligned vectors, so that a strip's next load finds the whole of its last store.

use super::tile_loop::Tile;
use crate::backend::Real;
use crate::backend::vector::{LANES, Vector};

/// Pixels along a tile's edge.
pub(in crate::raster) const TILE: usize = 16;
/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE * TILE;
/// Strips of a tile, in the order of their pixels.
pub(super) const STRIPS: usize = PIXELS / LANES;
/// A value for every pixel of a tile, row-major.
pub(super) type Buffer<E> = [[E; LANES]; STRIPS];

/// A projected Gaussian as the tile kernels read it.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::raster) struct Splat2 {
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
    /// Natural logarithm of the opacity.
    pub log_opacity: f64,
}

/// Rows and columns of the first pixels of the first `LANES` strips, which are [`GROUP_ROWS`] rows.
#[derive(Clone, Copy)]
pub(super) struct Grid<V> {
    rows: V,
    columns: V,
}

/// Rows that `LANES` strips make.
const GROUP_ROWS: usize = LANES * LANES / TILE;
const GROUPS: usize = TILE / GROUP_ROWS;

impl<V> Grid<V> {
    #[inline(always)]
    pub fn new<E: Real>() -> Self
    where
        V: Vector<E>,
    {
        let pixel: [usize; LANES] = std::array::from_fn(|strip| strip * LANES);
        let load = |x: [usize; LANES]| V::load(&x.map(|x| E::of(x as f64)));
        Self {
            rows: load(pixel.map(|p| p / TILE)),
            columns: load(pixel.map(|p| p % TILE)),
        }
    }
}

/// A Gaussian seen from the corner of a tile. Kernels work with base 2: their `u`, `v` are [`UNIT`] times those of
/// [`Splat2`], and alpha' is `2^(peak - u^2 - v^2)` before the cap.
#[derive(Clone, Copy, Default)]
pub(super) struct Corner<E> {
    /// At the tile's first pixel.
    u: E,
    v: E,
    /// Steps of `u` along a row and from row to row, and of `v` from row to row.
    du: E,
    du_row: E,
    dv: E,
    reach2: E,
    peak: E,
}

/// `sqrt(log2 e)`.
pub(super) const UNIT: f64 = 1.201_122_408_786_449_8;

impl<E: Real> Corner<E> {
    /// Of `s` over `tile`.
    #[inline(always)]
    pub fn new(s: &Splat2, tile: Tile<'_>) -> Self {
        // In f64 as far as the corner: a huge splat centred far away would lose its edge in f32.
        let x = tile.origin[0] as f64 + 0.5 - s.center[0];
        let y = tile.origin[1] as f64 + 0.5 - s.center[1];
        let (du, dv) = (UNIT * s.du, UNIT * s.dv);
        Self {
            u: E::of(du * (x - s.slope * y)),
            v: E::of(dv * y),
            du: E::of(du),
            du_row: E::of(-du * s.slope),
            dv: E::of(dv),
            reach2: E::of(UNIT * UNIT * s.reach * s.reach),
            peak: E::of(UNIT * UNIT * s.log_opacity),
        }
    }
}

/// One Gaussian over one tile.
pub(super) struct Footprint<E> {
    /// A bit for every strip that the ellipse reaches.
    pub strips: u32,
    /// `u` at the first pixel of every strip; `v` and `peak - v^2` there.
    u: [[E; LANES]; GROUPS],
    v: [[E; LANES]; GROUPS],
    top: [[E; LANES]; GROUPS],
    /// Step of `u` along a row.
    du: E,
}

impl<E: Real> Footprint<E> {
    #[inline(always)]
    pub fn new<V: Vector<E>>(corner: &Corner<E>, grid: &Grid<V>) -> Self {
        let du = corner.du;
        let [u, v, du_row, dv] = [corner.u, corner.v, corner.du_row, corner.dv].map(V::splat);
        let (top_u, top_v) = (
            grid.rows.fma(du_row, grid.columns.fma(V::splat(du), u)),
            grid.rows.fma(dv, v),
        );
        let minus_length = V::splat(-du * E::of((LANES - 1) as f64));
        let [reach2, peak, zero] = [corner.reach2, corner.peak, E::zero()].map(V::splat);
        let nothing = [[E::zero(); LANES]; GROUPS];
        let mut out = Self {
            strips: 0,
            u: nothing,
            v: nothing,
            top: nothing,
            du,
        };
        for group in 0..GROUPS {
            let rows = V::splat(E::of((group * GROUP_ROWS) as f64));
            let (u, v) = (rows.fma(du_row, top_u), rows.fma(dv, top_v));
            // Distance in u from the strip to the middle of the row section; NaN stays NaN, and reaches nothing.
            let away = zero.max(u.max(minus_length.sub(u)));
            let vv = v.mul(v);
            out.strips |= reach2.bits_above(away.fma(away, vv)) << (group * LANES);
            u.store(&mut out.u[group]);
            v.store(&mut out.v[group]);
            peak.sub(vv).store(&mut out.top[group]);
        }
        out
    }

    /// Calls `f` with every strip that is reached, in order.
    #[inline(always)]
    pub fn for_each(&self, mut f: impl FnMut(usize)) {
        let mut strips = self.strips;
        while strips != 0 {
            f(strips.trailing_zeros() as usize % STRIPS);
            strips &= strips - 1;
        }
    }

    /// alpha' at the pixels of a strip, 0 below the cut-off.
    #[inline(always)]
    pub fn alpha<V: Vector<E>>(&self, strip: usize, rule: &Rule<V>) -> V {
        let u: V = self.u(strip);
        rule.cut(
            u.fnma(u, V::splat(self.top.as_flattened()[strip]))
                .exp2_nonpositive(),
        )
    }

    /// `u` at the pixels of a strip.
    #[inline(always)]
    pub fn u<V: Vector<E>>(&self, strip: usize) -> V {
        V::ramp().fma(V::splat(self.du), V::splat(self.u.as_flattened()[strip]))
    }

    /// `v` at the pixels of a strip.
    #[inline(always)]
    pub fn v(&self, strip: usize) -> E {
        self.v.as_flattened()[strip]
    }
}

/// Constants of the blending rule.
#[derive(Clone, Copy)]
pub(super) struct Rule<V> {
    alpha_max: V,
    alpha_min: V,
    t_min: V,
    one: V,
}

impl<V> Rule<V> {
    #[inline(always)]
    pub fn new<E: Real>(s: &crate::raster::Settings) -> Self
    where
        V: Vector<E>,
    {
        let splat = |x: f64| V::splat(E::of(x));
        let [alpha_max, alpha_min, t_min] = [s.alpha_max, s.alpha_min, s.t_min].map(splat);
        Self {
            alpha_max,
            alpha_min,
            t_min,
            one: splat(1.0),
        }
    }

    /// The cap and the cut-off.
    #[inline(always)]
    fn cut<E>(&self, alpha: V) -> V
    where
        V: Vector<E>,
    {
        alpha.min(self.alpha_max).keep_from(self.alpha_min)
    }

    /// Weights `alpha' T`; updates `t`. A pixel that ends keeps its transmittance with the sign turned, which also stops
    /// it from taking anything more; `alpha` becomes 0 there.
    #[inline(always)]
    pub fn absorb<E>(&self, alpha: &mut V, t: &mut V) -> V
    where
        V: Vector<E>,
    {
        let next = alpha.fnma(*t, *t);
        *alpha = alpha.keep_above(next, self.t_min);
        let weight = alpha.mul(*t);
        *t = next.select_above(self.t_min, next, t.minus_abs());
        weight
    }

    /// `g` where alpha' is below the cap, else 0.
    #[inline(always)]
    pub fn below_cap<E>(&self, alpha: V, g: V) -> V
    where
        V: Vector<E>,
    {
        g.keep_above(self.alpha_max, alpha)
    }

    /// 1 in all lanes.
    pub fn one(&self) -> V
    where
        V: Copy,
    {
        self.one
    }
}

/// Transmittance of a tile's pixels: 1 inside an image of `size`, ended outside.
#[inline(always)]
pub(super) fn fresh_transmittance<E: Real>(tile: Tile<'_>, size: [usize; 2]) -> Buffer<E> {
    let mut t = [[-E::one(); LANES]; STRIPS];
    for (at, _, len) in tile.rows(size) {
        t.as_flattened_mut()[at..at + len].fill(E::one());
    }
    t
}

/// A bit for every strip that still has a pixel which takes more.
#[inline(always)]
pub(super) fn live_strips<E: Real, V: Vector<E>>(t: &Buffer<E>) -> u32 {
    let zero = V::splat(E::zero());
    t.iter().enumerate().fold(0, |live, (strip, t)| {
        live | u32::from(V::load(t).bits_above(zero) != 0) << strip
    })
}
