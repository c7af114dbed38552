//! Which pixels of a tile a projected Gaussian reaches, and its alpha' there (Eq. 2).
//!
//! A tile is cut into strips: neighbouring pixels of a row, as many as a register holds.

use crate::backend::Real;
use crate::backend::simd::Lanes;
use crate::raster::settings::Settings;

/// Pixels along a tile's edge.
pub(in crate::raster) const TILE: usize = 16;
/// Pixels of a tile.
pub(super) const PIXELS: usize = TILE * TILE;
/// Strips that a tile is cut into, at most: registers hold four numbers or more.
const MAX_STRIPS: usize = 64;

/// One tile: its first pixel and its Gaussians' ranks, front to back.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a> {
    pub origin: [usize; 2],
    pub ranks: &'a [u32],
}

impl Tile<'_> {
    /// For every row of the tile inside an image of `size`: its position in the tile's buffers and in the image, and its
    /// length there.
    #[inline(always)]
    pub fn rows(&self, size: [usize; 2]) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
        let [x, y] = self.origin;
        let len = (size[0] - x).min(TILE);
        (0..(size[1] - y).min(TILE)).map(move |row| (row * TILE, (y + row) * size[0] + x, len))
    }
}

/// Strips of a tile.
pub(super) const fn strips<E, S: Lanes<E>>() -> usize {
    PIXELS / S::LANES
}

/// A value for every pixel of a tile, row-major.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Buffer<E>(pub [E; PIXELS]);

impl<E: Real> Buffer<E> {
    pub fn zeros() -> Self {
        Self([E::zero(); PIXELS])
    }

    /// The values of a strip.
    #[inline(always)]
    pub fn get<S: Lanes<E>>(&self, strip: usize) -> S::V {
        // The remainder spares a check of bounds.
        S::registers(&self.0)[strip % strips::<E, S>()]
    }

    #[inline(always)]
    pub fn set<S: Lanes<E>>(&mut self, strip: usize, x: S::V) {
        S::registers_mut(&mut self.0)[strip % strips::<E, S>()] = x;
    }
}

/// A projected Gaussian as the tile kernels read it.
///
/// With the 2D covariance `[[X, B], [B, Y]]` and `s2 = X - B^2 / Y`, the exponent of Eq. 2 at an offset `(x, y)` from
/// the centre is `-(u^2 + v^2)` with `u = (x - B / Y y) / sqrt(2 s2)` and `v = y / sqrt(2 Y)`.
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
    /// Largest `sqrt(u^2 + v^2)` that contributes, with a margin for rounding.
    pub reach: f64,
    /// Natural logarithm of the opacity.
    pub log_opacity: f64,
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
    #[inline(always)]
    pub fn new(splat: &Splat2, tile: Tile<'_>) -> Self {
        // In f64 up to the corner: a huge splat centred far away would lose its edge in f32.
        let x = tile.origin[0] as f64 + 0.5 - splat.center[0];
        let y = tile.origin[1] as f64 + 0.5 - splat.center[1];
        let du = UNIT * splat.du;
        let dv = UNIT * splat.dv;
        Self {
            u: E::of(du * (x - splat.slope * y)),
            v: E::of(dv * y),
            du: E::of(du),
            du_row: E::of(-du * splat.slope),
            dv: E::of(dv),
            reach2: E::of(UNIT * UNIT * splat.reach * splat.reach),
            peak: E::of(UNIT * UNIT * splat.log_opacity),
        }
    }
}

/// Rows and columns of the first pixels of the first `LANES` strips.
pub(super) struct Grid<V> {
    rows: V,
    columns: V,
}

impl<V: Copy> Grid<V> {
    #[inline(always)]
    pub fn new<E: Real, S: Lanes<E, V = V>>(_: S) -> Self {
        let mut rows = [E::zero(); TILE];
        let mut columns = [E::zero(); TILE];
        for strip in 0..S::LANES {
            let pixel = strip * S::LANES;
            rows[strip] = E::of((pixel / TILE) as f64);
            columns[strip] = E::of((pixel % TILE) as f64);
        }
        Self {
            rows: S::registers(&rows)[0],
            columns: S::registers(&columns)[0],
        }
    }
}

/// One Gaussian over one tile.
pub(super) struct Footprint<E> {
    /// A bit for every strip that the ellipse reaches.
    pub strips: u64,
    /// `u`, `v` and `peak - v^2` at the first pixel of every strip.
    u: [E; MAX_STRIPS],
    v: [E; MAX_STRIPS],
    top: [E; MAX_STRIPS],
    /// Step of `u` along a row.
    du: E,
}

impl<E: Real> Footprint<E> {
    pub fn empty() -> Self {
        Self {
            strips: 0,
            u: [E::zero(); MAX_STRIPS],
            v: [E::zero(); MAX_STRIPS],
            top: [E::zero(); MAX_STRIPS],
            du: E::zero(),
        }
    }

    /// Becomes that of the Gaussian seen from `corner`.
    #[inline(always)]
    pub fn place<S: Lanes<E>>(&mut self, s: S, corner: &Corner<E>, grid: &Grid<S::V>) {
        let du_row = s.splat(corner.du_row);
        let dv = s.splat(corner.dv);
        let first_u = s.mul_add(
            grid.rows,
            du_row,
            s.mul_add(grid.columns, s.splat(corner.du), s.splat(corner.u)),
        );
        let first_v = s.mul_add(grid.rows, dv, s.splat(corner.v));
        let minus_length = s.splat(-corner.du * E::of((S::LANES - 1) as f64));
        let reach2 = s.splat(corner.reach2);
        let peak = s.splat(corner.peak);
        let zero = s.splat(E::zero());
        self.strips = 0;
        self.du = corner.du;
        for group in 0..strips::<E, S>() / S::LANES {
            let rows = s.splat(E::of((group * S::LANES * S::LANES / TILE) as f64));
            let u = s.mul_add(rows, du_row, first_u);
            let v = s.mul_add(rows, dv, first_v);
            let vv = s.mul(v, v);
            // Distance in u from the strip to the middle of the row section.
            let away = s.max(zero, s.max(u, s.sub(minus_length, u)));
            let reached = s.greater(reach2, s.mul_add(away, away, vv));
            self.strips |= u64::from(s.bits(reached)) << (group * S::LANES);
            S::registers_mut(&mut self.u)[group] = u;
            S::registers_mut(&mut self.v)[group] = v;
            S::registers_mut(&mut self.top)[group] = s.sub(peak, vv);
        }
    }

    /// Calls `f` with every strip that is reached, in order.
    #[inline(always)]
    pub fn for_each(&self, mut f: impl FnMut(usize)) {
        let mut strips = self.strips;
        while strips != 0 {
            f(strips.trailing_zeros() as usize);
            strips &= strips - 1;
        }
    }

    /// alpha' at the pixels of a strip, 0 below the cut-off.
    #[inline(always)]
    pub fn alpha<S: Lanes<E>>(&self, strip: usize, rule: &Rule<E, S>) -> S::V {
        let s = rule.s;
        let u = self.u(s, strip);
        let top = s.splat(self.top[strip % MAX_STRIPS]);
        rule.cut(s.exp2_nonpositive(s.neg_mul_add(u, u, top)))
    }

    /// `u` at the pixels of a strip.
    #[inline(always)]
    pub fn u<S: Lanes<E>>(&self, s: S, strip: usize) -> S::V {
        s.mul_add(
            s.ramp(),
            s.splat(self.du),
            s.splat(self.u[strip % MAX_STRIPS]),
        )
    }

    /// `v` at the pixels of a strip.
    #[inline(always)]
    pub fn v(&self, strip: usize) -> E {
        self.v[strip % MAX_STRIPS]
    }
}

/// The blending rule: cap, cut-off, and the end of a pixel.
pub(super) struct Rule<E, S: Lanes<E>> {
    pub s: S,
    alpha_max: S::V,
    alpha_min: S::V,
    t_min: S::V,
    one: S::V,
}

impl<E: Real, S: Lanes<E>> Rule<E, S> {
    #[inline(always)]
    pub fn new(s: S, settings: &Settings) -> Self {
        Self {
            s,
            alpha_max: s.splat(E::of(settings.alpha_max)),
            alpha_min: s.splat(E::of(settings.alpha_min)),
            t_min: s.splat(E::of(settings.t_min)),
            one: s.splat(E::one()),
        }
    }

    /// The cap and the cut-off.
    #[inline(always)]
    fn cut(&self, alpha: S::V) -> S::V {
        let alpha = self.s.min(alpha, self.alpha_max);
        self.s.keep(self.s.at_least(alpha, self.alpha_min), alpha)
    }

    /// One Gaussian over one strip: alpha' of its pixels, 0 where a pixel has ended, and the weights `alpha' T`
    /// (Eq. 3). Updates the transmittance. A pixel that ends keeps its transmittance with the sign turned, which also
    /// stops it from taking anything more.
    #[inline(always)]
    pub fn absorb(
        &self,
        footprint: &Footprint<E>,
        transmittance: &mut Buffer<E>,
        strip: usize,
    ) -> (S::V, S::V) {
        let s = self.s;
        let alpha = footprint.alpha(strip, self);
        let t = transmittance.get::<S>(strip);
        let next = s.neg_mul_add(alpha, t, t);
        let goes_on = s.greater(next, self.t_min);
        let alpha = s.keep(goes_on, alpha);
        transmittance.set::<S>(strip, s.select(goes_on, next, s.minus_abs(t)));
        (alpha, s.mul(alpha, t))
    }

    /// `dL/dalpha' alpha'` where alpha' is below the cap, else 0. `own` is `w d` of the Gaussian, `rest` is `R` behind it.
    #[inline(always)]
    pub fn alpha_gradient(&self, alpha: S::V, own: S::V, rest: S::V) -> S::V {
        let s = self.s;
        let odds = s.div(alpha, s.sub(self.one, alpha));
        let gradient = s.neg_mul_add(rest, odds, own);
        s.keep(s.greater(self.alpha_max, alpha), gradient)
    }
}

/// Transmittance of a tile's pixels: 1 inside an image of `size`, ended outside.
#[inline(always)]
pub(super) fn fresh_transmittance<E: Real>(tile: Tile<'_>, size: [usize; 2]) -> Buffer<E> {
    let mut t = Buffer([-E::one(); PIXELS]);
    for (at, _, len) in tile.rows(size) {
        t.0[at..at + len].fill(E::one());
    }
    t
}

/// A bit for every strip that still has a pixel which takes more.
#[inline(always)]
pub(super) fn live_strips<E: Real, S: Lanes<E>>(s: S, t: &Buffer<E>) -> u64 {
    let zero = s.splat(E::zero());
    let mut live = 0;
    for (strip, &t) in S::registers(&t.0).iter().enumerate() {
        live |= u64::from(s.bits(s.greater(t, zero)) != 0) << strip;
    }
    live
}
