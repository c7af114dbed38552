//! The contributing pairs of a tile as a list, for many channels and for the matrix `W` itself: a pair's weight is
//! computed once, over pixel lanes.

use super::footprint::{Buffer, Footprint, Rule};
use super::projected::Projected;
use super::tile_loop::{Pass, Tile, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, MEMBERS, Vector};
use crate::raster::settings::PairCounts;

/// Pairs of a Gaussian in a tile for which room is made beforehand; there is more when there are more.
const USUAL: usize = 24;

/// Contributing pairs of one tile, Gaussian by Gaussian, front to back.
pub(super) struct Pairs<E, const GEOMETRY: bool> {
    /// Transmittance, ended pixels negative.
    pub t: Buffer<E>,
    /// One past the last pair of each of the tile's Gaussians that was looked at.
    pub ends: Vec<u32>,
    /// Pixel within the tile, `row * TILE + column`, ascending for each Gaussian.
    pub pixels: Vec<u16>,
    pub weights: Vec<E>,
    /// alpha' and the kernels' u, v of each pair when `GEOMETRY`.
    pub alphas: Vec<E>,
    pub us: Vec<E>,
    pub vs: Vec<E>,
    pub counts: PairCounts,
}

struct PairPass<V, E, const GEOMETRY: bool> {
    rule: Rule<V>,
    pairs: Pairs<E, GEOMETRY>,
    /// Pairs so far; the lists are longer, so that a strip is written without asking for room for every pixel.
    len: usize,
}

impl<E: Real, V: Vector<E>, const GEOMETRY: bool> Pass<E, V> for PairPass<V, E, GEOMETRY> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.pairs.t
    }

    #[inline(always)]
    fn gather(&mut self, _ranks: &[u32]) {}

    #[inline(always)]
    fn take(&mut self, _next: usize, _entry: usize, footprint: &Footprint<E>) {
        let (pairs, mut len) = (&mut self.pairs, self.len);
        footprint.for_each(|strip| {
            let (mut alpha, mut t) = (footprint.alpha(strip, &self.rule), V::load(&pairs.t[strip]));
            let weight = self.rule.absorb(&mut alpha, &mut t);
            t.store(&mut pairs.t[strip]);
            pairs.counts.evaluated += LANES as u64;
            if len + LANES > pairs.pixels.len() {
                pairs.resize(2 * len + LANES);
            }
            // The lanes that contribute come first; the next pairs are written over the others.
            let members = weight.bits_above(V::splat(E::zero())) as usize;
            let from = &MEMBERS[members];
            if let Some(pixels) = pairs.pixels[len..].first_chunk_mut() {
                *pixels = from.map(|lane| (strip * LANES) as u16 + u16::from(lane));
            }
            let put = |list: &mut [E], lanes: V| {
                if let Some(to) = list[len..].first_chunk_mut() {
                    lanes.permute(from).store(to);
                }
            };
            put(&mut pairs.weights, weight);
            if GEOMETRY {
                put(&mut pairs.alphas, alpha);
                put(&mut pairs.us, footprint.u(strip));
                put(&mut pairs.vs, V::splat(footprint.v(strip)));
            }
            len += members.count_ones() as usize;
        });
        self.len = len;
        pairs.ends.push(len as u32);
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
    fn run<V: Vector<E>>(self) -> Self::Output {
        let Gather { p, tile, t } = self;
        let mut pairs = Pairs {
            t,
            ends: Vec::with_capacity(tile.ranks.len()),
            pixels: Vec::new(),
            weights: Vec::new(),
            alphas: Vec::new(),
            us: Vec::new(),
            vs: Vec::new(),
            counts: PairCounts::default(),
        };
        pairs.resize(USUAL * tile.ranks.len());
        let mut pass = PairPass::<V, E, GEOMETRY> {
            rule: Rule::new::<E>(&p.settings),
            pairs,
            len: 0,
        };
        walk(p, tile, &mut pass);
        let PairPass { mut pairs, len, .. } = pass;
        pairs.resize(len);
        pairs.counts.contributing = len as u64;
        pairs
    }
}

impl<E: Real, const GEOMETRY: bool> Pairs<E, GEOMETRY> {
    /// The pairs of `tile`, of pixels where `t` is positive.
    pub fn gather(p: &Projected<E>, tile: Tile<'_>, t: Buffer<E>) -> Self {
        dispatch(Gather { p, tile, t })
    }

    fn resize(&mut self, len: usize) {
        self.pixels.resize(len, 0);
        self.weights.resize(len, E::zero());
        if GEOMETRY {
            for list in [&mut self.alphas, &mut self.us, &mut self.vs] {
                list.resize(len, E::zero());
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
