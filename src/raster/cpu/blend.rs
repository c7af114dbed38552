//! Blending of a few channels (Eq. 3-4) and its adjoint: pixel lanes inside, channels unrolled.

use super::footprint::{Buffer, Footprint, Rule, Tile, fresh_transmittance};
use super::projected::{Blended, Projected};
use super::tile_loop::{
    LIVE_CHECK_INTERVAL, Pass, for_each_tile_row, gather_rows, sum_over_tiles, walk,
};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};

/// Blends `values`, `[N, used]`, at most C channels: `S(p) = sum_i s_i alpha'_i T_i` and
/// `T_(i+1) = T_i (1 - alpha'_i)` (Eq. 3).
pub(super) fn blend<E: Real, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    used: usize,
) -> Blended<E> {
    let values = &p.in_depth_order(values, used, C);
    for_each_tile_row(p, used, |tile, image, transmittance| {
        E::dispatch(BlendTile::<E, C> {
            p,
            tile,
            values,
            used,
            image,
            transmittance,
        });
    })
}

struct BlendTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    /// Channels of the image, the first of `C`.
    used: usize,
    /// `[rows of the tile, W, used]`.
    image: &'a mut [E],
    transmittance: &'a mut [E],
}

impl<E: Real, const C: usize> Kernel<E> for BlendTile<'_, E, C> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let size = self.p.size();
        let mut pass = BlendPass::<E, S, C> {
            rule: Rule::new(s, &self.p.settings),
            values: self.values,
            t: fresh_transmittance(self.tile, size),
            sums: [Buffer::zeros(); C],
            near: [[E::zero(); C]; LIVE_CHECK_INTERVAL],
        };
        walk(s, self.p, self.tile, &mut pass);
        let BlendPass { t, sums, .. } = &pass;
        let sums = &sums[..self.used];
        write_tile(self.tile, size, t, sums, self.image, self.transmittance);
    }
}

struct BlendPass<'a, E, S: Lanes<E>, const C: usize> {
    rule: Rule<E, S>,
    values: &'a [E],
    t: Buffer<E>,
    sums: [Buffer<E>; C],
    /// Values of the next Gaussians.
    near: [[E; C]; LIVE_CHECK_INTERVAL],
}

impl<E: Real, S: Lanes<E>, const C: usize> Pass<E> for BlendPass<'_, E, S, C> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        gather_rows(self.values, ranks, &mut self.near);
    }

    #[inline(always)]
    fn take(&mut self, next: usize, _entry: usize, footprint: &Footprint<E>) {
        if footprint.strips == 0 {
            return;
        }
        let s = self.rule.s;
        let value = self.near[next].map(|value| s.splat(value));
        footprint.for_each(|strip| {
            let (_, weight) = self.rule.absorb(footprint, &mut self.t, strip);
            for (sums, &value) in self.sums.iter_mut().zip(&value) {
                let sum = s.mul_add(weight, value, sums.get::<S>(strip));
                sums.set::<S>(strip, sum);
            }
        });
    }
}

/// `W^T image`, `[visible, C]` front to back; `image` is `[H, W, C]`.
pub(super) fn adjoint<E: Real, const C: usize>(p: &Projected<E>, image: &[E]) -> Vec<E> {
    sum_over_tiles(p, C, |tile, sums| {
        E::dispatch(AdjointTile::<E, C> {
            p,
            tile,
            image,
            sums,
        })
    })
}

struct AdjointTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[H, W, C]`.
    image: &'a [E],
    /// `[entries, C]`, zeros.
    sums: &'a mut [E],
}

impl<E: Real, const C: usize> Kernel<E> for AdjointTile<'_, E, C> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let size = self.p.size();
        let mut pass = AdjointPass::<E, S, C> {
            rule: Rule::new(s, &self.p.settings),
            t: fresh_transmittance(self.tile, size),
            image: tile_image(self.image, self.tile, size),
            sums: self.sums,
        };
        walk(s, self.p, self.tile, &mut pass);
    }
}

struct AdjointPass<'a, E, S: Lanes<E>, const C: usize> {
    rule: Rule<E, S>,
    t: Buffer<E>,
    image: [Buffer<E>; C],
    sums: &'a mut [E],
}

impl<E: Real, S: Lanes<E>, const C: usize> Pass<E> for AdjointPass<'_, E, S, C> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn take(&mut self, _next: usize, entry: usize, footprint: &Footprint<E>) {
        if footprint.strips == 0 {
            return;
        }
        let s = self.rule.s;
        let mut sum = [s.splat(E::zero()); C];
        footprint.for_each(|strip| {
            let (_, weight) = self.rule.absorb(footprint, &mut self.t, strip);
            for (sum, image) in sum.iter_mut().zip(&self.image) {
                *sum = s.mul_add(weight, image.get::<S>(strip), *sum);
            }
        });
        s.write_totals(&sum, &mut self.sums[entry * C..][..C]);
    }
}

/// Writes the sums of a tile into `image`, `[rows of the tile, W, channels]`, and `t` into `transmittance`.
#[inline(always)]
pub(super) fn write_tile<E: Real>(
    tile: Tile<'_>,
    size: [usize; 2],
    t: &Buffer<E>,
    sums: &[Buffer<E>],
    image: &mut [E],
    transmittance: &mut [E],
) {
    let first = tile.origin[1] * size[0];
    for (from, to, len) in tile.rows(size) {
        let to = to - first;
        for x in 0..len {
            transmittance[to + x] = t.0[from + x].abs();
            let pixel = &mut image[(to + x) * sums.len()..][..sums.len()];
            for (sums, channel) in sums.iter().zip(pixel) {
                *channel = sums.0[from + x];
            }
        }
    }
}

/// A tile's part of `image` `[H, W, C]`, zero outside.
#[inline(always)]
pub(super) fn tile_image<E: Real, const C: usize>(
    image: &[E],
    tile: Tile<'_>,
    size: [usize; 2],
) -> [Buffer<E>; C] {
    let mut out = [Buffer::zeros(); C];
    for (to, from, len) in tile.rows(size) {
        for x in 0..len {
            for (c, out) in out.iter_mut().enumerate() {
                out.0[to + x] = image[(from + x) * C + c];
            }
        }
    }
    out
}
