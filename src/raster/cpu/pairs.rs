//! The contributing pairs of a tile as a list, for many channels and for the matrix `W` itself. The weight of a pair is computed
//! once, over pixel lanes.

use super::footprint::{Buffer, Footprint, Rule, Tile, fresh_transmittance};
use super::projected::Projected;
use super::tile_loop::{Pass, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes, places};

/// Initial capacity of the lists: pairs of one Gaussian in a tile.
const INITIAL_CAPACITY: usize = 24;

/// Contributing pairs of one tile, Gaussian by Gaussian, front to back.
pub(super) struct Pairs<E, const GEOMETRY: bool> {
    /// Transmittance, negative where a pixel has ended.
    pub t: Buffer<E>,
    /// For each Gaussian of the tile that was visited: one past its last pair.
    pub ends: Vec<u32>,
    /// Pixel within the tile, `row * TILE + column`, ascending for each Gaussian.
    pub pixels: Vec<u16>,
    /// alpha' T.
    pub weights: Vec<E>,
    /// alpha' and the kernels' u, v of each pair when `GEOMETRY`.
    pub geometry: [Vec<E>; 3],
}

impl<E: Real, const GEOMETRY: bool> Pairs<E, GEOMETRY> {
    /// The pairs of `tile`, of the pixels of the image that are `used`. The others take nothing.
    pub fn gather(p: &Projected<E>, tile: Tile<'_>, used: impl Fn(usize) -> bool) -> Self {
        let mut t = fresh_transmittance(tile, p.size());
        for (at, pixel, len) in tile.rows(p.size()) {
            for x in (0..len).filter(|x| !used(pixel + x)) {
                t.0[at + x] = -E::one();
            }
        }
        E::dispatch(Gather { p, tile, t })
    }

    fn resize(&mut self, len: usize) {
        self.pixels.resize(len, 0);
        self.weights.resize(len, E::zero());
        if GEOMETRY {
            for values in &mut self.geometry {
                values.resize(len, E::zero());
            }
        }
    }

    /// Pairs of the tile's `i`-th Gaussian, as positions.
    #[inline(always)]
    pub fn range(&self, i: usize) -> std::ops::Range<usize> {
        let first = if i == 0 { 0 } else { self.ends[i - 1] as usize };
        first..self.ends[i] as usize
    }
}

struct Gather<'a, E, const GEOMETRY: bool> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    t: Buffer<E>,
}

impl<E: Real, const GEOMETRY: bool> Kernel<E> for Gather<'_, E, GEOMETRY> {
    type Output = Pairs<E, GEOMETRY>;

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) -> Self::Output {
        let mut pairs = Pairs {
            t: self.t,
            ends: Vec::with_capacity(self.tile.ranks.len()),
            pixels: Vec::new(),
            weights: Vec::new(),
            geometry: [const { Vec::new() }; 3],
        };
        pairs.resize(INITIAL_CAPACITY * self.tile.ranks.len());
        let mut pass = PairPass {
            rule: Rule::new(s, &self.p.settings),
            pairs,
            len: 0,
        };
        walk(s, self.p, self.tile, &mut pass);
        let PairPass { mut pairs, len, .. } = pass;
        pairs.resize(len);
        pairs
    }
}

struct PairPass<E, S: Lanes<E>, const GEOMETRY: bool> {
    rule: Rule<E, S>,
    pairs: Pairs<E, GEOMETRY>,
    /// Pairs so far. The lists are longer, so that a strip resizes them once at most.
    len: usize,
}

impl<E: Real, S: Lanes<E>, const GEOMETRY: bool> Pass<E> for PairPass<E, S, GEOMETRY> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.pairs.t
    }

    #[inline(always)]
    fn take(&mut self, _next: usize, _entry: usize, footprint: &Footprint<E>) {
        let s = self.rule.s;
        let pairs = &mut self.pairs;
        let mut len = self.len;
        footprint.for_each(|strip| {
            let (alpha, weight) = self.rule.absorb(footprint, &mut pairs.t, strip);
            // Whole registers and whole bytes of bits are written.
            let room = S::LANES.max(8);
            if len + room > pairs.pixels.len() {
                pairs.resize(2 * len + room);
            }
            let members = s.bits(s.greater(weight, s.splat(E::zero())));
            // Lanes that contribute come first. The next pairs overwrite the rest.
            let to = len..len + S::LANES;
            S::registers_mut(&mut pairs.weights[to.clone()])[0] = s.compress(weight, members);
            if GEOMETRY {
                let v = s.splat(footprint.v(strip));
                let u = s.compress(footprint.u(s, strip), members);
                let geometry = [s.compress(alpha, members), u, v];
                for (values, register) in pairs.geometry.iter_mut().zip(geometry) {
                    S::registers_mut(&mut values[to.clone()])[0] = register;
                }
            }
            for eight in 0..room / 8 {
                let bits = members >> (8 * eight) & 0xff;
                let first = (strip * S::LANES + 8 * eight) as u16;
                let pixels = places(bits).map(|place| first + u16::from(place));
                pairs.pixels[len..len + 8].copy_from_slice(&pixels);
                len += bits.count_ones() as usize;
            }
        });
        self.len = len;
        pairs.ends.push(len as u32);
    }
}
