//! Blending of a few channels (Eq. 3-4) and its adjoint: pixel lanes inside, channels unrolled.

use super::footprint::{Buffer, Footprint, PIXELS, Rule, Tile, fresh_transmittance};
use super::projected::{Blended, Projected};
use super::tile_loop::{LOOK, Pass, for_each_tile_row, gather_rows, sum_over_tiles, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};

/// Another sum over the weights of a blending pass: one more channel of the image, or none.
pub(super) trait Beside<E> {
    /// Channels that [`Beside::channel`] has.
    const CHANNELS: usize;
    /// The next Gaussians have these ranks, [`LOOK`] at most.
    fn gather(&mut self, ranks: &[u32]);
    /// The next call of [`Beside::add`] is about the `next`-th of them.
    fn begin(&mut self, next: usize);
    /// Adds its weights in a strip.
    fn add<S: Lanes<E>>(&mut self, s: S, strip: usize, weight: S::V);
    /// The channel at each pixel.
    fn channel(&self) -> [E; PIXELS];
}

/// No other sum.
struct Nothing;

impl<E: Real> Beside<E> for Nothing {
    const CHANNELS: usize = 0;
    #[inline(always)]
    fn gather(&mut self, _ranks: &[u32]) {}
    #[inline(always)]
    fn begin(&mut self, _next: usize) {}
    #[inline(always)]
    fn add<S: Lanes<E>>(&mut self, _s: S, _strip: usize, _weight: S::V) {}
    #[inline(always)]
    fn channel(&self) -> [E; PIXELS] {
        [E::zero(); PIXELS]
    }
}

/// Blends the first `used` of `values`, `[visible, C]` front to back: `S(p) = sum_i s_i alpha'_i T_i` and
/// `T_(i+1) = T_i (1 - alpha'_i)` (Eq. 3).
pub(super) fn blend<E: Real, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    used: usize,
) -> Blended<E> {
    blend_beside::<E, _, C>(p, values, used, || Nothing)
}

/// [`blend`] with another sum over the weights. `beside` makes it for each tile. Its channel follows the others.
pub(super) fn blend_beside<E: Real, B: Beside<E>, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    used: usize,
    beside: impl Fn() -> B + Sync,
) -> Blended<E> {
    for_each_tile_row(p, used + B::CHANNELS, |tile, image, transmittance| {
        E::dispatch(BlendTile::<E, B, C> {
            p,
            tile,
            values,
            used,
            beside: beside(),
            image,
            transmittance,
        });
    })
}

struct BlendTile<'a, E, B, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    /// Channels of the image, the first of `C`.
    used: usize,
    beside: B,
    /// `[rows of the tile, W, used + B::CHANNELS]`.
    image: &'a mut [E],
    transmittance: &'a mut [E],
}

impl<E: Real, B: Beside<E>, const C: usize> Kernel<E> for BlendTile<'_, E, B, C> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let size = self.p.size();
        let mut pass = BlendPass::<E, S, B, C> {
            rule: Rule::new(s, &self.p.settings),
            values: self.values,
            t: fresh_transmittance(self.tile, size),
            sums: [Buffer::zeros(); C],
            beside: self.beside,
            near: [[E::zero(); C]; LOOK],
        };
        walk(s, self.p, self.tile, &mut pass);
        let stride = self.used + B::CHANNELS;
        let beside = pass.beside.channel();
        let first = self.tile.origin[1] * size[0];
        for (from, to, len) in self.tile.rows(size) {
            let to = to - first;
            for x in 0..len {
                self.transmittance[to + x] = pass.t.0[from + x].abs();
                let pixel = &mut self.image[(to + x) * stride..][..stride];
                let (channels, one_more) = pixel.split_at_mut(self.used);
                for (sums, channel) in pass.sums.iter().zip(channels) {
                    *channel = sums.0[from + x];
                }
                one_more.fill(beside[from + x]);
            }
        }
    }
}

struct BlendPass<'a, E, S: Lanes<E>, B, const C: usize> {
    rule: Rule<E, S>,
    values: &'a [E],
    t: Buffer<E>,
    sums: [Buffer<E>; C],
    beside: B,
    /// Values of the next Gaussians.
    near: [[E; C]; LOOK],
}

impl<E: Real, S: Lanes<E>, B: Beside<E>, const C: usize> Pass<E> for BlendPass<'_, E, S, B, C> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        gather_rows(self.values, ranks, &mut self.near);
        self.beside.gather(ranks);
    }

    #[inline(always)]
    fn take(&mut self, next: usize, _entry: usize, footprint: &Footprint<E>) {
        if footprint.strips == 0 {
            return;
        }
        let s = self.rule.s;
        let value = self.near[next].map(|value| s.splat(value));
        self.beside.begin(next);
        footprint.for_each(|strip| {
            let (_, weight) = self.rule.absorb(footprint, &mut self.t, strip);
            self.beside.add(s, strip, weight);
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
    fn gather(&mut self, _ranks: &[u32]) {}

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
        for (to, sum) in self.sums[entry * C..][..C].iter_mut().zip(sum) {
            *to = s.total(sum);
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
