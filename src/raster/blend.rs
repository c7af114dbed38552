//! Blending of up to four channels and its adjoint: pixel lanes inside, channels unrolled.

use super::footprint::{
    BUFFER, Footprint, Lanes, Rule, STRIDE, TILE, Visit, fresh_transmittance, live_rows, load, store, walk,
};
use super::projected::{Blended, Projected};
use super::settings::PairCounts;
use crate::ops::Real;
use crate::ops::vector::{Kernel, LANES, Vector, dispatch};
use rayon::prelude::*;

/// List entries between two looks at which rows are still live.
pub(super) const LOOK: usize = 16;
/// Bytes of per-entry sums held at once.
const BAND_BYTES: usize = 64 << 20;

/// One tile: its first pixel and its Gaussians' ranks, front to back.
#[derive(Clone, Copy)]
pub(super) struct Tile<'a> {
    pub origin: [usize; 2],
    pub ranks: &'a [u32],
}

impl Tile<'_> {
    /// Calls `f` with the position in the tile's buffers, and in an image `width` wide, of every row of the tile inside
    /// the image, and with that row's length.
    #[inline(always)]
    pub fn rows(&self, size: [usize; 2]) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
        let [x, y] = self.origin;
        let len = (size[0] - x).min(TILE);
        (0..(size[1] - y).min(TILE)).map(move |row| (row * STRIDE, (y + row) * size[0] + x, len))
    }
}

/// Runs `f` over all tiles in parallel, each with its part of the image and transmittance rows of its row of tiles.
pub(super) fn for_each_tile_row<E: Real>(
    p: &Projected<E>,
    channels: usize,
    f: impl Fn(Tile<'_>, &mut [E], &mut [E]) + Sync,
) -> Blended<E> {
    let [w, h] = p.size();
    let mut out = Blended { image: vec![E::zero(); w * h * channels], transmittance: vec![E::zero(); w * h] };
    let mut image = out.image.as_mut_slice();
    let mut parts = Vec::with_capacity(p.tiles.rows);
    for (row, transmittance) in out.transmittance.chunks_mut(w * TILE).enumerate() {
        let (own, rest) = image.split_at_mut(transmittance.len() * channels);
        parts.push((row, own, transmittance));
        image = rest;
    }
    parts.into_par_iter().with_max_len(1).for_each(|(row, image, transmittance)| {
        for column in 0..p.tiles.columns {
            let ranks = &p.tiles.ranks[p.tiles.tile(column, row)];
            f(Tile { origin: [column * TILE, row * TILE], ranks }, image, transmittance);
        }
    });
    out
}

/// Runs `f` over all tiles in parallel; it writes `width` sums for each of the tile's list entries. Returns the sums
/// per rank, `[visible, width]`, added up in an order that does not depend on the number of threads.
pub(super) fn sum_over_tiles<E: Real>(p: &Projected<E>, width: usize, f: impl Fn(Tile<'_>, &mut [E]) + Sync) -> Vec<E> {
    let mut sums = vec![E::zero(); p.splats.len() * width];
    if width == 0 {
        return sums;
    }
    let mut cursors = vec![0_u32; p.splats.len()];
    let mut row = 0;
    while row < p.tiles.rows {
        // As many rows of tiles as fit, at least one.
        let mut end = row + 1;
        while end < p.tiles.rows
            && p.tiles.tile_rows(row..end + 1).len() * width * std::mem::size_of::<E>() <= BAND_BYTES
        {
            end += 1;
        }
        let band = p.tiles.tile_rows(row..end);
        let mut partial = vec![E::zero(); band.len() * width];
        let mut rest = partial.as_mut_slice();
        let mut parts = Vec::with_capacity((end - row) * p.tiles.columns);
        for tile_row in row..end {
            for column in 0..p.tiles.columns {
                let ranks = &p.tiles.ranks[p.tiles.tile(column, tile_row)];
                let (own, others) = rest.split_at_mut(ranks.len() * width);
                rest = others;
                if !ranks.is_empty() {
                    parts.push((Tile { origin: [column * TILE, tile_row * TILE], ranks }, own));
                }
            }
        }
        parts.into_par_iter().for_each(|(tile, own)| f(tile, own));
        sums.par_chunks_mut(width * 256).zip(cursors.par_chunks_mut(256)).enumerate().for_each(
            |(chunk, (sums, cursors))| {
                for ((sum, cursor), rank) in sums.chunks_exact_mut(width).zip(cursors).zip(chunk * 256..) {
                    for &slot in &p.tiles.slots(rank)[*cursor as usize..] {
                        if slot as usize >= band.end {
                            break;
                        }
                        *cursor += 1;
                        let part = &partial[(slot as usize - band.start) * width..][..width];
                        for (s, &x) in sum.iter_mut().zip(part) {
                            *s += x;
                        }
                    }
                }
            },
        );
        row = end;
    }
    sums
}

struct BlendTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    image: &'a mut [E],
    transmittance: &'a mut [E],
}

struct BlendLanes<E, V, const C: usize> {
    rule: Rule<V>,
    t: [E; BUFFER],
    sums: [[E; BUFFER]; C],
    value: [V; C],
}

impl<E: Real, V: Vector<E>, const C: usize> Visit<E, V> for BlendLanes<E, V, C> {
    #[inline(always)]
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>) {
        let (mut alpha, mut t) = (pair.alpha, load(&self.t, at));
        let weight = self.rule.absorb(&mut alpha, &mut t);
        store(&mut self.t, at, t);
        for (sums, &value) in self.sums.iter_mut().zip(&self.value) {
            let sum = weight.fma(value, load(sums, at));
            store(sums, at, sum);
        }
    }
}

impl<E: Real, const C: usize> Kernel<E> for BlendTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self { p, tile, values, image, transmittance } = self;
        let mut lanes = BlendLanes::<E, V, C> {
            rule: Rule::new::<E>(&p.settings),
            t: fresh_transmittance(tile.origin, p.size()),
            sums: [[E::zero(); BUFFER]; C],
            value: [V::splat(E::zero()); C],
        };
        for ranks in tile.ranks.chunks(LOOK) {
            let live = live_rows(&lanes.t);
            if live == 0 {
                break;
            }
            for &rank in ranks {
                let f = Footprint::new(&p.splats[rank as usize], tile.origin);
                for (lanes, &value) in lanes.value.iter_mut().zip(&values[rank as usize * C..][..C]) {
                    *lanes = V::splat(value);
                }
                let rule = lanes.rule;
                walk(&f, &rule, live, &mut lanes);
            }
        }
        let first = tile.origin[1] * p.size()[0];
        for (from, to, len) in tile.rows(p.size()) {
            let to = to - first;
            for x in 0..len {
                transmittance[to + x] = lanes.t[from + x].abs();
                for c in 0..C {
                    image[(to + x) * C + c] = lanes.sums[c][from + x];
                }
            }
        }
    }
}

/// Blends `values`, `[visible, C]` front to back.
pub(super) fn blend<E: Real, const C: usize>(p: &Projected<E>, values: &[E]) -> Blended<E> {
    for_each_tile_row(p, C, |tile, image, transmittance| {
        dispatch(BlendTile::<E, C> { p, tile, values, image, transmittance });
    })
}

struct AdjointTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[H, W, C]`.
    image: &'a [E],
    sums: &'a mut [E],
}

struct AdjointLanes<E, V, const C: usize> {
    rule: Rule<V>,
    t: [E; BUFFER],
    image: [[E; BUFFER]; C],
    sums: [V; C],
}

impl<E: Real, V: Vector<E>, const C: usize> Visit<E, V> for AdjointLanes<E, V, C> {
    #[inline(always)]
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>) {
        let (mut alpha, mut t) = (pair.alpha, load(&self.t, at));
        let weight = self.rule.absorb(&mut alpha, &mut t);
        store(&mut self.t, at, t);
        for (sum, image) in self.sums.iter_mut().zip(&self.image) {
            *sum = weight.fma(load(image, at), *sum);
        }
    }
}

impl<E: Real, const C: usize> Kernel<E> for AdjointTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self { p, tile, image, sums } = self;
        let mut lanes = AdjointLanes::<E, V, C> {
            rule: Rule::new::<E>(&p.settings),
            t: fresh_transmittance(tile.origin, p.size()),
            image: [[E::zero(); BUFFER]; C],
            sums: [V::splat(E::zero()); C],
        };
        for (to, from, len) in tile.rows(p.size()) {
            for x in 0..len {
                for c in 0..C {
                    lanes.image[c][to + x] = image[(from + x) * C + c];
                }
            }
        }
        for (ranks, sums) in tile.ranks.chunks(LOOK).zip(sums.chunks_mut(LOOK * C)) {
            let live = live_rows(&lanes.t);
            if live == 0 {
                break;
            }
            for (&rank, sums) in ranks.iter().zip(sums.chunks_exact_mut(C)) {
                let f = Footprint::new(&p.splats[rank as usize], tile.origin);
                lanes.sums = [V::splat(E::zero()); C];
                let rule = lanes.rule;
                walk(&f, &rule, live, &mut lanes);
                for (sum, lanes) in sums.iter_mut().zip(&lanes.sums) {
                    *sum = lanes.total();
                }
            }
        }
    }
}

/// `W^T image`, `[visible, C]` front to back; `image` is `[H, W, C]`.
pub(super) fn adjoint<E: Real, const C: usize>(p: &Projected<E>, image: &[E]) -> Vec<E> {
    sum_over_tiles(p, C, |tile, sums| dispatch(AdjointTile::<E, C> { p, tile, image, sums }))
}

struct CountTile<'a, E> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
}

struct CountLanes<E, V> {
    rule: Rule<V>,
    t: [E; BUFFER],
    counts: PairCounts,
}

impl<E: Real, V: Vector<E>> Visit<E, V> for CountLanes<E, V> {
    #[inline(always)]
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>) {
        let (mut alpha, mut t) = (pair.alpha, load(&self.t, at));
        self.rule.absorb(&mut alpha, &mut t);
        store(&mut self.t, at, t);
        let mut lanes = [E::zero(); LANES];
        alpha.store(&mut lanes);
        self.counts.evaluated += LANES as u64;
        self.counts.contributing += lanes.iter().map(|&a| u64::from(a > E::zero())).sum::<u64>();
    }
}

impl<E: Real> Kernel<E> for CountTile<'_, E> {
    type Output = PairCounts;
    #[inline(always)]
    fn run<V: Vector<E>>(self) -> PairCounts {
        let Self { p, tile } = self;
        let t = fresh_transmittance(tile.origin, p.size());
        let mut lanes = CountLanes::<E, V> { rule: Rule::new::<E>(&p.settings), t, counts: PairCounts::default() };
        for ranks in tile.ranks.chunks(LOOK) {
            let live = live_rows(&lanes.t);
            if live == 0 {
                break;
            }
            for &rank in ranks {
                let f = Footprint::new(&p.splats[rank as usize], tile.origin);
                let rule = lanes.rule;
                walk(&f, &rule, live, &mut lanes);
            }
        }
        lanes.counts
    }
}

/// Counts the pairs of a whole view.
pub(super) fn count_pairs<E: Real>(p: &Projected<E>) -> PairCounts {
    let tiles = p.tiles.columns * p.tiles.rows;
    (0..tiles)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % p.tiles.columns, i / p.tiles.columns);
            let ranks = &p.tiles.ranks[p.tiles.tile(x, y)];
            dispatch(CountTile { p, tile: Tile { origin: [x * TILE, y * TILE], ranks } })
        })
        .reduce(PairCounts::default, |a, b| PairCounts {
            evaluated: a.evaluated + b.evaluated,
            contributing: a.contributing + b.contributing,
        })
}
