//! Blending of a few channels and its adjoint: pixel lanes inside, channels unrolled.

use super::footprint::{Buffer, Footprint, PIXELS, Rule, STRIPS, fresh_transmittance};
use super::projected::{Blended, Projected};
use super::tile_loop::{LOOK, Pass, Tile, for_each_tile_row, gather_rows, sum_over_tiles, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, Vector};

/// What a blending pass sums of the weights besides, pixel by pixel, as one more channel of the image or none.
pub(super) trait Beside<E> {
    /// Channels that [`Beside::channel`] has.
    const CHANNELS: usize;
    /// The next Gaussians have these ranks, [`LOOK`] at most.
    fn gather(&mut self, ranks: &[u32]);
    /// The `next`-th of them comes, and reaches some strip.
    fn begin(&mut self, next: usize);
    /// Its weights in a strip.
    fn add<V: Vector<E>>(&mut self, strip: usize, weight: V);
    /// What the channel has at each pixel.
    fn channel(&self) -> [E; PIXELS];
}

/// Nothing besides.
struct Nothing;

impl<E: Real> Beside<E> for Nothing {
    const CHANNELS: usize = 0;
    #[inline(always)]
    fn gather(&mut self, _ranks: &[u32]) {}
    #[inline(always)]
    fn begin(&mut self, _next: usize) {}
    #[inline(always)]
    fn add<V: Vector<E>>(&mut self, _strip: usize, _weight: V) {}
    #[inline(always)]
    fn channel(&self) -> [E; PIXELS] {
        [E::zero(); PIXELS]
    }
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

struct BlendPass<'a, E, V, B, const C: usize> {
    rule: Rule<V>,
    values: &'a [E],
    t: Buffer<E>,
    sums: [Buffer<E>; C],
    beside: B,
    /// Values of the next Gaussians.
    near: [[E; C]; LOOK],
}

impl<E: Real, V: Vector<E>, B: Beside<E>, const C: usize> Pass<E, V> for BlendPass<'_, E, V, B, C> {
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
        let value = self.near[next].map(V::splat);
        self.beside.begin(next);
        footprint.for_each(|strip| {
            let (mut alpha, mut t) = (footprint.alpha(strip, &self.rule), V::load(&self.t[strip]));
            let weight = self.rule.absorb(&mut alpha, &mut t);
            t.store(&mut self.t[strip]);
            self.beside.add(strip, weight);
            for (sums, &value) in self.sums.iter_mut().zip(&value) {
                weight
                    .fma(value, V::load(&sums[strip]))
                    .store(&mut sums[strip]);
            }
        });
    }
}

impl<E: Real, B: Beside<E>, const C: usize> Kernel<E> for BlendTile<'_, E, B, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self {
            p,
            tile,
            values,
            used,
            beside,
            image,
            transmittance,
        } = self;
        let mut pass = BlendPass::<E, V, B, C> {
            rule: Rule::new::<E>(&p.settings),
            values,
            t: fresh_transmittance(tile, p.size()),
            sums: [[[E::zero(); LANES]; STRIPS]; C],
            beside,
            near: [[E::zero(); C]; LOOK],
        };
        walk(p, tile, &mut pass);
        let stride = used + B::CHANNELS;
        let beside = pass.beside.channel();
        let first = tile.origin[1] * p.size()[0];
        for (from, to, len) in tile.rows(p.size()) {
            let to = to - first;
            for x in 0..len {
                transmittance[to + x] = pass.t.as_flattened()[from + x].abs();
                let (channels, one_more) = image[(to + x) * stride..][..stride].split_at_mut(used);
                for (sums, image) in pass.sums.iter().zip(channels) {
                    *image = sums.as_flattened()[from + x];
                }
                one_more.fill(beside[from + x]);
            }
        }
    }
}

/// Blends the first `used` of `values`, `[visible, C]` front to back.
pub(super) fn blend<E: Real, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    used: usize,
) -> Blended<E> {
    blend_beside::<E, _, C>(p, values, used, || Nothing)
}

/// [`blend`], and what `beside`, made for each tile, sums of the weights: the image has its channel after the others.
pub(super) fn blend_beside<E: Real, B: Beside<E>, const C: usize>(
    p: &Projected<E>,
    values: &[E],
    used: usize,
    beside: impl Fn() -> B + Sync,
) -> Blended<E> {
    for_each_tile_row(p, used + B::CHANNELS, |tile, image, transmittance| {
        dispatch(BlendTile::<E, B, C> {
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

struct AdjointTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[H, W, C]`.
    image: &'a [E],
    /// `[entries, C]`.
    sums: &'a mut [E],
}

struct AdjointPass<'a, E, V, const C: usize> {
    rule: Rule<V>,
    t: Buffer<E>,
    image: [Buffer<E>; C],
    sums: &'a mut [E],
}

impl<E: Real, V: Vector<E>, const C: usize> Pass<E, V> for AdjointPass<'_, E, V, C> {
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, _ranks: &[u32]) {}

    #[inline(always)]
    fn take(&mut self, _next: usize, entry: usize, footprint: &Footprint<E>) {
        let mut sum = [V::splat(E::zero()); C];
        footprint.for_each(|strip| {
            let (mut alpha, mut t) = (footprint.alpha(strip, &self.rule), V::load(&self.t[strip]));
            let weight = self.rule.absorb(&mut alpha, &mut t);
            t.store(&mut self.t[strip]);
            for (sum, image) in sum.iter_mut().zip(&self.image) {
                *sum = weight.fma(V::load(&image[strip]), *sum);
            }
        });
        for (to, sum) in self.sums[entry * C..][..C].iter_mut().zip(sum) {
            *to = sum.total();
        }
    }
}

impl<E: Real, const C: usize> Kernel<E> for AdjointTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self {
            p,
            tile,
            image,
            sums,
        } = self;
        let mut pass = AdjointPass::<E, V, C> {
            rule: Rule::new::<E>(&p.settings),
            t: fresh_transmittance(tile, p.size()),
            image: tile_image(image, tile, p.size()),
            sums,
        };
        walk(p, tile, &mut pass);
    }
}

/// A tile's part of `image` `[H, W, C]`, zero outside.
#[inline(always)]
pub(super) fn tile_image<E: Real, const C: usize>(
    image: &[E],
    tile: Tile<'_>,
    size: [usize; 2],
) -> [Buffer<E>; C] {
    let mut out = [[[E::zero(); LANES]; STRIPS]; C];
    for (to, from, len) in tile.rows(size) {
        for x in 0..len {
            for (c, out) in out.iter_mut().enumerate() {
                out.as_flattened_mut()[to + x] = image[(from + x) * C + c];
            }
        }
    }
    out
}

/// `W^T image`, `[visible, C]` front to back; `image` is `[H, W, C]`.
pub(super) fn adjoint<E: Real, const C: usize>(p: &Projected<E>, image: &[E]) -> Vec<E> {
    sum_over_tiles(p, C, |tile, sums| {
        dispatch(AdjointTile::<E, C> {
            p,
            tile,
            image,
            sums,
        })
    })
}
