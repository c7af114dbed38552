//! Blending of many channels, its adjoint and its backward pass: the pairs of a tile first, then the channels in blocks,
//! with channel lanes inside.

use super::blend::write_tile;
use super::footprint::{PIXELS, Tile};
use super::pairs::Pairs;
use super::pixel_gradients::{PixelGradients, drift, geometry_sums};
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

/// Runs `$body` for each [`Block`] of the channels, the widest that fits, with the constant `$k` for its number of channels.
macro_rules! for_each_block {
    ($pairs:expr, $ranks:expr, $values:expr, $width:expr; |$block:ident, $k:ident| $body:expr) => {
        let mut channel = 0;
        while channel < $width {
            let $block = Block {
                pairs: $pairs,
                ranks: $ranks,
                values: $values,
                width: $width,
                channel,
            };
            channel += if $width - channel >= WIDE {
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

/// `K` channels from `channel` on of one tile.
struct Block<'a, E, const GEOMETRY: bool> {
    pairs: &'a Pairs<E, GEOMETRY>,
    ranks: &'a [u32],
    /// `[visible, width]`.
    values: &'a [E],
    width: usize,
    channel: usize,
}

impl<'a, E, const GEOMETRY: bool> Block<'a, E, GEOMETRY> {
    /// Values of the tile's `i`-th Gaussian, `k` channels.
    #[inline(always)]
    fn values_of(&self, i: usize, k: usize) -> &'a [E] {
        &self.values[self.ranks[i] as usize * self.width + self.channel..][..k]
    }
}

/// `out[pixel] += weight value`; `out` is `[PIXELS, K]`.
struct BlendBlock<'a, E, const K: usize> {
    block: Block<'a, E, false>,
    out: &'a mut [E],
}

impl<E: Real, const K: usize> Kernel<E> for BlendBlock<'_, E, K> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let pairs = self.block.pairs;
        for i in 0..pairs.ends.len() {
            let mut value = [s.splat(E::zero()); REGISTERS];
            let value = &mut value[..K / S::LANES];
            value.copy_from_slice(S::registers(self.block.values_of(i, K)));
            let range = pairs.range(i);
            let pixels = pairs.pixels[range.clone()].iter();
            for (&pixel, &weight) in pixels.zip(&pairs.weights[range]) {
                let weight = s.splat(weight);
                let out = S::registers_mut(&mut self.out[pixel as usize * K..][..K]);
                for (out, &value) in out.iter_mut().zip(&*value) {
                    *out = s.mul_add(weight, value, *out);
                }
            }
        }
    }
}

/// `sums[i] += weight * image[pixel]`, and with `GEOMETRY` `projections[pair] += value[i] . image[pixel]`.
struct AdjointBlock<'a, E, const K: usize, const GEOMETRY: bool> {
    block: Block<'a, E, GEOMETRY>,
    /// `[PIXELS, K]`.
    image: &'a [E],
    /// `[entries, stride]`, the block's channels from `at` on.
    sums: &'a mut [E],
    stride: usize,
    at: usize,
    /// Channels of the block that are not padding.
    used: usize,
    projections: &'a mut [E],
}

impl<E: Real, const K: usize, const GEOMETRY: bool> Kernel<E> for AdjointBlock<'_, E, K, GEOMETRY> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let pairs = self.block.pairs;
        let zero = s.splat(E::zero());
        for i in 0..pairs.ends.len() {
            let mut sum = [zero; REGISTERS];
            let mut value = [zero; REGISTERS];
            let sum = &mut sum[..K / S::LANES];
            let value = &mut value[..K / S::LANES];
            if GEOMETRY {
                value.copy_from_slice(S::registers(self.block.values_of(i, K)));
            }
            for pair in pairs.range(i) {
                let image = S::registers(&self.image[pairs.pixels[pair] as usize * K..][..K]);
                let weight = s.splat(pairs.weights[pair]);
                for (sum, &image) in sum.iter_mut().zip(image) {
                    *sum = s.mul_add(weight, image, *sum);
                }
                if GEOMETRY {
                    let mut part = zero;
                    for (&value, &image) in value.iter().zip(image) {
                        part = s.mul_add(value, image, part);
                    }
                    self.projections[pair] += s.total(part);
                }
            }
            let mut lanes = [E::zero(); K];
            S::registers_mut(&mut lanes).copy_from_slice(sum);
            self.sums[i * self.stride + self.at..][..self.used]
                .copy_from_slice(&lanes[..self.used]);
        }
    }
}

/// Blends `values`, `[N, channels]`.
pub(super) fn blend<E: Real>(p: &Projected<E>, values: &[E], channels: usize) -> Blended<E> {
    let width = channels.next_multiple_of(NARROW);
    let values = p.in_depth_order(values, channels, width);
    let size = p.size();
    for_each_tile_row(p, channels, |tile, image, transmittance| {
        let pairs = Pairs::<E, false>::gather(p, tile, |_| true);
        let first = tile.origin[1] * size[0];
        write_tile(tile, size, &pairs.t, &[], &mut [], transmittance);
        for_each_block!(&pairs, tile.ranks, &values, width; |block, K| {
            let channel = block.channel;
            let mut out = vec![E::zero(); PIXELS * K];
            E::dispatch(BlendBlock::<E, K> { block, out: &mut out });
            let used = K.min(channels - channel);
            for (from, to, len) in tile.rows(size) {
                for x in 0..len {
                    image[(to - first + x) * channels + channel..][..used]
                        .copy_from_slice(&out[(from + x) * K..][..used]);
                }
            }
        });
    })
}

/// A tile's part of channels `channel..channel + used` of `image` `[H, W, channels]`, as `[PIXELS, k]`.
fn tile_channels<E: Real>(
    image: &[E],
    tile: Tile<'_>,
    size: [usize; 2],
    channels: usize,
    channel: usize,
    k: usize,
) -> Vec<E> {
    let mut out = vec![E::zero(); PIXELS * k];
    let used = k.min(channels - channel);
    for (to, from, len) in tile.rows(size) {
        for x in 0..len {
            out[(to + x) * k..][..used]
                .copy_from_slice(&image[(from + x) * channels + channel..][..used]);
        }
    }
    out
}

/// `W^T image`, `[visible, channels]` front to back; `image` is `[H, W, channels]`.
pub(super) fn adjoint<E: Real>(p: &Projected<E>, image: &[E], channels: usize) -> Vec<E> {
    let size = p.size();
    let width = channels.next_multiple_of(NARROW);
    sum_over_tiles(p, channels, |tile, sums| {
        let pairs = Pairs::<E, false>::gather(p, tile, |_| true);
        for_each_block!(&pairs, tile.ranks, &[], width; |block, K| {
            let at = block.channel;
            let image = tile_channels(image, tile, size, channels, at, K);
            let used = K.min(channels - at);
            E::dispatch(AdjointBlock::<E, K, false> {
                block, image: &image, sums, stride: channels, at, used, projections: &mut [],
            });
        });
    })
}

/// Moments (6), channel gradients and, when `ABSOLUTE`, the two sums of absolute values of every visible Gaussian,
/// `[visible, geometry_sums + channels]` front to back. `values` is `[N, channels]`.
pub(super) fn backward<E: Real, const ABSOLUTE: bool>(
    p: &Projected<E>,
    values: &[E],
    channels: usize,
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    let size = p.size();
    let width = channels.next_multiple_of(NARROW);
    let stride = geometry_sums(ABSOLUTE) + channels;
    let values = p.in_depth_order(values, channels, width);
    sum_over_tiles(p, stride, |tile, sums| {
        let pairs = Pairs::<E, true>::gather(p, tile, |_| true);
        let mut projections = vec![E::zero(); pairs.pixels.len()];
        for_each_block!(&pairs, tile.ranks, &values, width; |block, K| {
            let channel = block.channel;
            let image = tile_channels(pixels.d_image, tile, size, channels, channel, K);
            let used = K.min(channels - channel);
            let at = 6 + channel;
            E::dispatch(AdjointBlock::<E, K, true> {
                block, image: &image, sums, stride, at, used, projections: &mut projections,
            });
        });
        let alpha_max = E::of(p.settings.alpha_max);
        let mut budget = [E::zero(); PIXELS];
        for (to, from, len) in tile.rows(size) {
            for x in 0..len {
                budget[to + x] = pixels.budget(from + x, channels);
            }
        }
        for (i, sums) in (0..pairs.ends.len()).zip(sums.chunks_exact_mut(stride)) {
            let mut m = [E::zero(); 6];
            let mut absolute = [E::zero(); 2];
            let [u_x, u_y, v_y] = if ABSOLUTE {
                drift(&p.splats[tile.ranks[i] as usize])
            } else {
                [E::zero(); 3]
            };
            for pair in pairs.range(i) {
                let [alpha, u, v] = pairs.geometry[pair];
                let own = pairs.weights[pair] * projections[pair];
                let rest = &mut budget[pairs.pixels[pair] as usize];
                *rest -= own;
                if alpha < alpha_max {
                    let g = own - *rest * alpha / (E::one() - alpha);
                    for (m, x) in m.iter_mut().zip([E::one(), u, v, u * u, u * v, v * v]) {
                        *m += g * x;
                    }
                    if ABSOLUTE {
                        absolute[0] += (g * u * u_x).abs();
                        absolute[1] += (g * (v * v_y + u * u_y)).abs();
                    }
                }
            }
            sums[..6].copy_from_slice(&m);
            if ABSOLUTE {
                sums[6 + channels..].copy_from_slice(&absolute);
            }
        }
    })
}
