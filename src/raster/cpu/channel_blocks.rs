//! Blending of many channels, its adjoint and its backward pass: the pairs of a tile first, then the channels in blocks,
//! with channel lanes inside.

use super::blend::write_tile;
use super::footprint::{Buffer, PIXELS, Rule, TILE, Tile};
use super::moments::{MOMENTS, Moments, drift};
use super::pairs::Pairs;
use super::pixel_gradients::{PixelGradients, geometry_sums};
use super::projected::{Blended, Projected};
use super::tile_loop::{for_each_tile_row, sum_over_tiles};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};

/// Channels of a narrow block: rows of padded values are a multiple of it.
const NARROW: usize = 16;
/// Channels of a wide block.
const WIDE: usize = 32;
/// Registers of a block, at most: they hold four numbers or more.
const REGISTERS: usize = WIDE / 4;

/// Runs `$body` for each [`Block`] of the channels from `$first` on, the widest that fits, with the constant `$k` for its number
/// of channels.
macro_rules! for_each_block {
    ($first:expr; |$block:ident, $k:ident| $body:expr) => {
        let mut $block = $first;
        while $block.channel < $block.channels {
            $block.channel += if $block.channels - $block.channel > NARROW {
                const $k: usize = WIDE;
                $body;
                $k
            } else {
                const $k: usize = NARROW;
                $body;
                $k
            };
        }
    };
}

/// Channels from `channel` on of one tile.
struct Block<'a, E, const GEOMETRY: bool> {
    pairs: &'a Pairs<E, GEOMETRY>,
    tile: Tile<'a>,
    /// Of the image.
    size: [usize; 2],
    channels: usize,
    /// Rows of the visible Gaussians, padded to a multiple of [`NARROW`] channels.
    values: &'a [E],
    channel: usize,
}

impl<'a, E: Real, const GEOMETRY: bool> Block<'a, E, GEOMETRY> {
    /// The channels from the first on.
    fn first(
        p: &Projected<E>,
        tile: Tile<'a>,
        pairs: &'a Pairs<E, GEOMETRY>,
        values: &'a [E],
        channels: usize,
    ) -> Self {
        Self {
            pairs,
            tile,
            size: p.size(),
            channels,
            values,
            channel: 0,
        }
    }

    /// Values of the tile's `i`-th Gaussian, `k` channels.
    #[inline(always)]
    fn values_of(&self, i: usize, k: usize) -> &'a [E] {
        let width = self.channels.next_multiple_of(NARROW);
        &self.values[self.tile.ranks[i] as usize * width + self.channel..][..k]
    }

    /// Those of `k` channels that are not padding.
    #[inline(always)]
    fn used(&self, k: usize) -> usize {
        k.min(self.channels - self.channel)
    }
}

/// `K` channels of every pixel of a tile, in whole cache lines. It is large, so kernels make it themselves: their frames are not
/// part of those that split the work.
#[repr(align(64))]
struct TileChannels<E, const K: usize>([[E; K]; PIXELS]);

impl<E: Real, const K: usize> TileChannels<E, K> {
    #[inline(always)]
    fn zeros() -> Self {
        Self([[E::zero(); K]; PIXELS])
    }

    /// Reads the block's channels of `image`, `[H, W, channels]`.
    #[inline(always)]
    fn read<const G: bool>(&mut self, block: &Block<'_, E, G>, image: &[E]) {
        let used = block.used(K);
        for (to, from, len) in block.tile.rows(block.size) {
            for (x, pixel) in self.0[to..to + len].iter_mut().enumerate() {
                let values = &image[(from + x) * block.channels + block.channel..][..used];
                pixel[..used].copy_from_slice(values);
            }
        }
    }

    /// Writes the block's channels of `image`, `[rows of the tile, W, channels]`.
    #[inline(always)]
    fn write<const G: bool>(&self, block: &Block<'_, E, G>, image: &mut [E]) {
        let used = block.used(K);
        let first = block.tile.origin[1] * block.size[0];
        for (from, to, len) in block.tile.rows(block.size) {
            for (x, pixel) in self.0[from..from + len].iter().enumerate() {
                image[(to - first + x) * block.channels + block.channel..][..used]
                    .copy_from_slice(&pixel[..used]);
            }
        }
    }

    #[inline(always)]
    fn pixel(&self, pixel: u16) -> &[E; K] {
        // The remainder spares a check of bounds.
        &self.0[pixel as usize % PIXELS]
    }

    #[inline(always)]
    fn pixel_mut(&mut self, pixel: u16) -> &mut [E; K] {
        &mut self.0[pixel as usize % PIXELS]
    }
}

/// `image[pixel] = sum of weight value`.
struct BlendBlock<'a, E, const K: usize> {
    block: &'a Block<'a, E, false>,
    /// `[rows of the tile, W, channels]`.
    image: &'a mut [E],
}

impl<E: Real, const K: usize> Kernel<E> for BlendBlock<'_, E, K> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let pairs = self.block.pairs;
        let mut sums = TileChannels::<E, K>::zeros();
        for i in 0..pairs.ends.len() {
            let mut value = [s.splat(E::zero()); REGISTERS];
            let value = &mut value[..K / S::LANES];
            value.copy_from_slice(S::registers(self.block.values_of(i, K)));
            let range = pairs.range(i);
            let pixels = pairs.pixels[range.clone()].iter();
            for (&pixel, &weight) in pixels.zip(&pairs.weights[range]) {
                let weight = s.splat(weight);
                let sums = S::registers_mut(sums.pixel_mut(pixel));
                for (sum, &value) in sums.iter_mut().zip(&*value) {
                    *sum = s.mul_add(weight, value, *sum);
                }
            }
        }
        sums.write(self.block, self.image);
    }
}

/// `sums[i] += weight * image[pixel]`, and with `GEOMETRY` `projections[pair] += value[i] . image[pixel]`.
struct AdjointBlock<'a, E, const K: usize, const GEOMETRY: bool> {
    block: &'a Block<'a, E, GEOMETRY>,
    /// `[H, W, channels]`.
    image: &'a [E],
    /// `[entries, stride]`; with `GEOMETRY` the channels follow the moments.
    sums: &'a mut [E],
    stride: usize,
    projections: &'a mut [E],
}

impl<E: Real, const K: usize, const GEOMETRY: bool> Kernel<E> for AdjointBlock<'_, E, K, GEOMETRY> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let pairs = self.block.pairs;
        let mut tile = TileChannels::<E, K>::zeros();
        tile.read(self.block, self.image);
        let used = self.block.used(K);
        let at = if GEOMETRY { MOMENTS } else { 0 } + self.block.channel;
        let zero = s.splat(E::zero());
        for i in 0..pairs.ends.len() {
            let mut sum = [zero; REGISTERS];
            let mut value = [zero; REGISTERS];
            let sum = &mut sum[..K / S::LANES];
            let value = &mut value[..K / S::LANES];
            if GEOMETRY {
                value.copy_from_slice(S::registers(self.block.values_of(i, K)));
            }
            let range = pairs.range(i);
            // Adds a pair to the sums. The lanes of the result add up to its projection.
            let mut add = |(&pixel, &weight): (&u16, &E)| {
                let image = S::registers(tile.pixel(pixel));
                let weight = s.splat(weight);
                let mut projection = zero;
                for ((sum, &image), &value) in sum.iter_mut().zip(image).zip(&*value) {
                    *sum = s.mul_add(weight, image, *sum);
                    projection = s.mul_add(value, image, projection);
                }
                projection
            };
            let mut pairs = pairs.pixels[range.clone()]
                .iter()
                .zip(&pairs.weights[range.clone()]);
            if !GEOMETRY {
                pairs.for_each(|pair| {
                    add(pair);
                });
            } else {
                let (eights, rest) = self.projections[range].as_chunks_mut::<8>();
                for eight in eights {
                    let parts = std::array::from_fn(|_| pairs.next().map_or(zero, &mut add));
                    for (projection, total) in eight.iter_mut().zip(s.totals(parts)) {
                        *projection += total;
                    }
                }
                for (projection, pair) in rest.iter_mut().zip(pairs) {
                    *projection += s.total(add(pair));
                }
            }
            let mut lanes = [E::zero(); K];
            S::registers_mut(&mut lanes).copy_from_slice(sum);
            self.sums[i * self.stride + at..][..used].copy_from_slice(&lanes[..used]);
        }
    }
}

/// Blends `values`, `[N, channels]`.
pub(super) fn blend<E: Real>(p: &Projected<E>, values: &[E], channels: usize) -> Blended<E> {
    let values = &p.in_depth_order(values, channels, channels.next_multiple_of(NARROW));
    let size = p.size();
    for_each_tile_row(p, channels, |tile, image, transmittance| {
        let pairs = &Pairs::<E, false>::gather(p, tile, |_| true);
        write_tile(tile, size, &pairs.t, &[], &mut [], transmittance);
        let first = Block::first(p, tile, pairs, values, channels);
        for_each_block!(first; |block, K| {
            E::dispatch(BlendBlock::<E, K> { block: &block, image });
        });
    })
}

/// `W^T image`, `[visible, channels]` front to back; `image` is `[H, W, channels]`.
pub(super) fn adjoint<E: Real>(p: &Projected<E>, image: &[E], channels: usize) -> Vec<E> {
    sum_over_tiles(p, channels, |tile, sums| {
        let pairs = &Pairs::<E, false>::gather(p, tile, |_| true);
        let first = Block::first(p, tile, pairs, &[], channels);
        for_each_block!(first; |block, K| {
            E::dispatch(AdjointBlock::<E, K, false> {
                block: &block, image, sums, stride: channels, projections: &mut [],
            });
        });
    })
}

/// Moments, channel gradients and, when `ABSOLUTE`, the two sums of absolute values of every visible Gaussian,
/// `[visible, geometry_sums + channels]` front to back. `values` is `[N, channels]`.
pub(super) fn backward<E: Real, const ABSOLUTE: bool>(
    p: &Projected<E>,
    values: &[E],
    channels: usize,
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    let size = p.size();
    let stride = geometry_sums(ABSOLUTE) + channels;
    let values = &p.in_depth_order(values, channels, channels.next_multiple_of(NARROW));
    sum_over_tiles(p, stride, |tile, sums| {
        let pairs = Pairs::<E, true>::gather(p, tile, |_| true);
        let mut projections = vec![E::zero(); pairs.pixels.len()];
        let first = Block::first(p, tile, &pairs, values, channels);
        for_each_block!(first; |block, K| {
            E::dispatch(AdjointBlock::<E, K, true> {
                block: &block,
                image: pixels.d_image,
                sums,
                stride,
                projections: &mut projections,
            });
        });
        let mut rest = Buffer::zeros();
        for (to, from, len) in tile.rows(size) {
            for x in 0..len {
                rest.0[to + x] = pixels.budget(from + x, channels);
            }
        }
        E::dispatch(GeometryOfTile::<E, ABSOLUTE> {
            p,
            ranks: tile.ranks,
            pairs,
            projections,
            rest,
            sums,
            stride,
        });
    })
}

/// Moments of the Gaussians of a tile, once all channels are projected.
struct GeometryOfTile<'a, E, const ABSOLUTE: bool> {
    p: &'a Projected<E>,
    ranks: &'a [u32],
    pairs: Pairs<E, true>,
    /// `d` of each pair.
    projections: Vec<E>,
    /// `R` of every pixel.
    rest: Buffer<E>,
    /// `[entries, stride]`: moments first, sums of absolute values last.
    sums: &'a mut [E],
    stride: usize,
}

impl<E: Real, const ABSOLUTE: bool> Kernel<E> for GeometryOfTile<'_, E, ABSOLUTE> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(mut self, s: S) {
        let rule = Rule::new(s, &self.p.settings);
        let entries = self.sums.chunks_exact_mut(self.stride);
        for (i, sums) in (0..self.pairs.ends.len()).zip(entries) {
            let range = self.pairs.range(i);
            let own = &mut self.pairs.weights[range.clone()];
            let rest = &mut self.projections[range.clone()];
            // From weights and projections to `w d` and `R`.
            let pixels = &self.pairs.pixels[range.clone()];
            for ((own, rest), &pixel) in own.iter_mut().zip(&mut *rest).zip(pixels) {
                *own *= *rest;
                let left = &mut self.rest.0[pixel as usize % PIXELS];
                *left -= *own;
                *rest = *left;
            }
            let drift = if ABSOLUTE {
                drift(&self.p.splats[self.ranks[i] as usize])
            } else {
                [E::zero(); 3]
            };
            let mut moments = Moments::<E, S, ABSOLUTE>::new(s, drift);
            let [alpha, u, v] = self.pairs.geometry.each_ref().map(|x| &x[range.clone()]);
            for_each_register(s, [alpha, own, rest, u, v], |[alpha, own, rest, u, v]| {
                moments.add(rule.alpha_gradient(alpha, own, rest), u, v);
            });
            let [x, y] = moments.minus_absolute;
            let [a, b, c, d, e, f] = moments.moments;
            let [geometry @ .., minus_x, minus_y] = s.totals([a, b, c, d, e, f, x, y]);
            sums[..geometry.len()].copy_from_slice(&geometry);
            if ABSOLUTE {
                let last = sums.len() - 2;
                sums[last..].copy_from_slice(&[-minus_x, -minus_y]);
            }
        }
    }
}

/// Calls `f` with the registers of five slices of one length, the last one filled up with zeros; none holds more than [`TILE`] numbers.
#[inline(always)]
fn for_each_register<E: Real, S: Lanes<E>>(_: S, slices: [&[E]; 5], mut f: impl FnMut([S::V; 5])) {
    let whole = slices[0].len() / S::LANES * S::LANES;
    for at in (0..whole).step_by(S::LANES) {
        f(slices.map(|x| S::registers(&x[at..at + S::LANES])[0]));
    }
    if whole < slices[0].len() {
        f(slices.map(|x| {
            let mut filled = [E::zero(); TILE];
            filled[..x.len() - whole].copy_from_slice(&x[whole..]);
            S::registers(&filled)[0]
        }));
    }
}
