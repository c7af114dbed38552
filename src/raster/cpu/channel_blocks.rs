//! Blending of many channels, its adjoint and its backward pass: the pairs of a tile first, then the channels in blocks,
//! with channel lanes inside.

use super::backward::{PixelGradients, drift, geometry_sums};
use super::footprint::{PIXELS, fresh_transmittance};
use super::pairs::Pairs;
use super::projected::{Blended, Projected};
use super::tile_loop::{Tile, for_each_tile_row, sum_over_tiles};
use crate::backend::Real;
use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, Vector};

/// Channels per row of padded values: a multiple of this.
const ALIGN: usize = 8;

/// Runs `$body` with the constant `$k` bound to the widest block, 32 channels or fewer, that fits `$left`.
macro_rules! block {
    ($left:expr, $k:ident => $body:expr) => {
        match $left {
            32.. => {
                const $k: usize = 32;
                $body
            }
            24.. => {
                const $k: usize = 24;
                $body
            }
            16.. => {
                const $k: usize = 16;
                $body
            }
            _ => {
                const $k: usize = 8;
                $body
            }
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

/// `out[pixel] += weight * value`, `out` is `[PIXELS, K]`.
struct BlendBlock<'a, E, const K: usize>(Block<'a, E, false>, &'a mut [E]);

impl<E: Real, const K: usize> Kernel<E> for BlendBlock<'_, E, K> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let (
            Block {
                pairs,
                ranks,
                values,
                width,
                channel,
            },
            out,
        ) = (self.0, self.1);
        for i in 0..pairs.ends.len() {
            let Some(&value) = values[ranks[i] as usize * width + channel..].first_chunk::<K>()
            else {
                return;
            };
            let range = pairs.range(i);
            for (&pixel, &weight) in pairs.pixels[range.clone()]
                .iter()
                .zip(&pairs.weights[range])
            {
                let Some(out) = out[pixel as usize * K..].first_chunk_mut::<K>() else {
                    return;
                };
                let weight = V::splat(weight);
                for (out, value) in vectors_mut(out).zip(vectors(&value)) {
                    let sum = weight.fma(V::load(value), V::load(out));
                    sum.store(out);
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
    fn run<V: Vector<E>>(self) {
        let Self {
            block:
                Block {
                    pairs,
                    ranks,
                    values,
                    width,
                    channel,
                },
            image,
            sums,
            stride,
            at,
            used,
            projections,
        } = self;
        for i in 0..pairs.ends.len() {
            let mut sum = [E::zero(); K];
            let mut value = [E::zero(); K];
            if GEOMETRY {
                value.copy_from_slice(&values[ranks[i] as usize * width + channel..][..K]);
            }
            for pair in pairs.range(i) {
                let Some(image) = image[pairs.pixels[pair] as usize * K..].first_chunk::<K>()
                else {
                    return;
                };
                let weight = V::splat(pairs.weights[pair]);
                for (sum, image) in vectors_mut(&mut sum).zip(vectors(image)) {
                    weight.fma(V::load(image), V::load(sum)).store(sum);
                }
                if GEOMETRY {
                    let mut part = V::splat(E::zero());
                    for (value, image) in vectors(&value).zip(vectors(image)) {
                        part = V::load(value).fma(V::load(image), part);
                    }
                    projections[pair] += part.total();
                }
            }
            sums[i * stride + at..][..used].copy_from_slice(&sum[..used]);
        }
    }
}

/// `K` numbers as vectors.
#[inline(always)]
fn vectors<E, const K: usize>(x: &[E; K]) -> impl Iterator<Item = &[E; LANES]> {
    x.as_chunks().0.iter()
}

/// [`vectors`], to write to.
#[inline(always)]
fn vectors_mut<E, const K: usize>(x: &mut [E; K]) -> impl Iterator<Item = &mut [E; LANES]> {
    x.as_chunks_mut().0.iter_mut()
}

/// Blends `values`, `[N, channels]`.
pub(super) fn blend<E: Real>(p: &Projected<E>, values: &[E], channels: usize) -> Blended<E> {
    let width = channels.next_multiple_of(ALIGN);
    let values = p.in_depth_order(values, channels, width);
    let size = p.size();
    for_each_tile_row(p, channels, |tile, image, transmittance| {
        let pairs = Pairs::<E, false>::gather(p, tile, fresh_transmittance(tile, size));
        let first = tile.origin[1] * size[0];
        for (from, to, len) in tile.rows(size) {
            for x in 0..len {
                transmittance[to - first + x] = pairs.t.as_flattened()[from + x].abs();
            }
        }
        let mut channel = 0;
        while channel < width {
            let block = Block {
                pairs: &pairs,
                ranks: tile.ranks,
                values: &values,
                width,
                channel,
            };
            channel += block!(width - channel, K => {
                let mut out = vec![E::zero(); PIXELS * K];
                dispatch(BlendBlock::<E, K>(block, &mut out));
                let used = K.min(channels - channel);
                for (from, to, len) in tile.rows(size) {
                        for x in 0..len {
                        image[(to - first + x) * channels + channel..][..used]
                            .copy_from_slice(&out[(from + x) * K..][..used]);
                    }
                }
                K
            });
        }
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
    let width = channels.next_multiple_of(ALIGN);
    sum_over_tiles(p, channels, |tile, sums| {
        let pairs = Pairs::<E, false>::gather(p, tile, fresh_transmittance(tile, size));
        let mut channel = 0;
        while channel < width {
            let block = Block {
                pairs: &pairs,
                ranks: tile.ranks,
                values: &[],
                width,
                channel,
            };
            channel += block!(width - channel, K => {
                let image = tile_channels(image, tile, size, channels, channel, K);
                let used = K.min(channels - channel);
                dispatch(AdjointBlock::<E, K, false> {
                    block, image: &image, sums, stride: channels, at: channel, used, projections: &mut [],
                });
                K
            });
        }
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
    let width = channels.next_multiple_of(ALIGN);
    let stride = geometry_sums(ABSOLUTE) + channels;
    let values = p.in_depth_order(values, channels, width);
    sum_over_tiles(p, stride, |tile, sums| {
        let pairs = Pairs::<E, true>::gather(p, tile, fresh_transmittance(tile, size));
        let mut projections = vec![E::zero(); pairs.pixels.len()];
        let mut channel = 0;
        while channel < width {
            let block = Block {
                pairs: &pairs,
                ranks: tile.ranks,
                values: &values,
                width,
                channel,
            };
            channel += block!(width - channel, K => {
                let image = tile_channels(pixels.d_image, tile, size, channels, channel, K);
                let used = K.min(channels - channel);
                let at = 6 + channel;
                dispatch(AdjointBlock::<E, K, true> {
                    block, image: &image, sums, stride, at, used, projections: &mut projections,
                });
                K
            });
        }
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
                let (alpha, u, v) = (pairs.alphas[pair], pairs.us[pair], pairs.vs[pair]);
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
