//! The contributing pairs of a tile as a list, for many channels and for the matrix `W` itself.
//!
//! A pair's weight is computed once, over pixel lanes; the channels follow in blocks with channel lanes inside.

use super::blend::{LOOK, Tile, for_each_tile_row, sum_over_tiles};
use super::footprint::{
    BUFFER, Footprint, Lanes, Rule, STRIDE, TILE, Visit, fresh_transmittance, live_rows, load, store, walk,
};
use super::geometry::Moments;
use super::projected::{Blended, Projected};
use crate::ops::vector::{Kernel, LANES, Vector, dispatch};
use crate::ops::{Real, SparseMatrix};
use rayon::prelude::*;

/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;
/// Channels per row of padded values: a multiple of this.
const ALIGN: usize = 8;

/// Contributing pairs of one tile, Gaussian by Gaussian, front to back.
pub(super) struct Pairs<E, const GEOMETRY: bool> {
    /// Transmittance in the tile's buffer layout, ended pixels negative.
    t: [E; BUFFER],
    /// One past the last pair of each of the tile's Gaussians that was looked at.
    ends: Vec<u32>,
    /// Pixel within the tile, `row * TILE + column`.
    pixels: Vec<u16>,
    weights: Vec<E>,
    /// alpha', u, v of each pair when `GEOMETRY`.
    shape: Vec<[E; 3]>,
}

struct PairLanes<'a, E, V, const GEOMETRY: bool> {
    rule: Rule<V>,
    pairs: &'a mut Pairs<E, GEOMETRY>,
}

impl<E: Real, V: Vector<E>, const GEOMETRY: bool> Visit<E, V> for PairLanes<'_, E, V, GEOMETRY> {
    #[inline(always)]
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>) {
        let (mut alpha, mut t) = (pair.alpha, load(&self.pairs.t, at));
        let weight = self.rule.absorb(&mut alpha, &mut t);
        store(&mut self.pairs.t, at, t);
        let mut weights = [E::zero(); LANES];
        weight.store(&mut weights);
        let (mut alphas, mut us) = ([E::zero(); LANES], [E::zero(); LANES]);
        if GEOMETRY {
            alpha.store(&mut alphas);
            pair.u.store(&mut us);
        }
        let first = at - at / STRIDE * (STRIDE - TILE);
        for l in 0..LANES {
            if weights[l] > E::zero() {
                self.pairs.pixels.push((first + l) as u16);
                self.pairs.weights.push(weights[l]);
                if GEOMETRY {
                    self.pairs.shape.push([alphas[l], us[l], pair.v]);
                }
            }
        }
    }
}

struct Gather<'a, E, const GEOMETRY: bool> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    t: [E; BUFFER],
}

impl<E: Real, const GEOMETRY: bool> Kernel<E> for Gather<'_, E, GEOMETRY> {
    type Output = Pairs<E, GEOMETRY>;
    #[inline(always)]
    fn run<V: Vector<E>>(self) -> Self::Output {
        let Gather { p, tile, t } = self;
        let mut pairs = Pairs {
            t,
            ends: Vec::with_capacity(tile.ranks.len()),
            pixels: Vec::with_capacity(16 * tile.ranks.len()),
            weights: Vec::with_capacity(16 * tile.ranks.len()),
            shape: Vec::new(),
        };
        let rule = Rule::new::<E>(&p.settings);
        let mut lanes = PairLanes::<E, V, GEOMETRY> { rule, pairs: &mut pairs };
        for ranks in tile.ranks.chunks(LOOK) {
            let live = live_rows(&lanes.pairs.t);
            if live == 0 {
                break;
            }
            for &rank in ranks {
                let f = Footprint::new(&p.splats[rank as usize], tile.origin);
                walk(&f, &rule, live, &mut lanes);
                lanes.pairs.ends.push(lanes.pairs.pixels.len() as u32);
            }
        }
        pairs
    }
}

impl<E: Real, const GEOMETRY: bool> Pairs<E, GEOMETRY> {
    /// The pairs of `tile`, of pixels where `t` is positive.
    fn gather(p: &Projected<E>, tile: Tile<'_>, t: [E; BUFFER]) -> Self {
        dispatch(Gather { p, tile, t })
    }

    /// Pairs of the tile's `i`-th Gaussian, as positions.
    #[inline(always)]
    fn range(&self, i: usize) -> std::ops::Range<usize> {
        let first = if i == 0 { 0 } else { self.ends[i - 1] as usize };
        first..self.ends[i] as usize
    }
}

/// Runs `$body` with the constant `$k` bound to the widest of 64, 32, 16, 8 that fits `$left`.
macro_rules! block {
    ($left:expr, $k:ident => $body:expr) => {
        match $left {
            64.. => {
                const $k: usize = 64;
                $body
            }
            32.. => {
                const $k: usize = 32;
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
        let (Block { pairs, ranks, values, width, channel }, out) = (self.0, self.1);
        for i in 0..pairs.ends.len() {
            let Some(&value) = values[ranks[i] as usize * width + channel..].first_chunk::<K>() else { return };
            let range = pairs.range(i);
            for (&pixel, &weight) in pairs.pixels[range.clone()].iter().zip(&pairs.weights[range]) {
                let Some(out) = out[pixel as usize * K..].first_chunk_mut::<K>() else { return };
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
        let Self { block: Block { pairs, ranks, values, width, channel }, image, sums, stride, at, used, projections } =
            self;
        for i in 0..pairs.ends.len() {
            let mut sum = [E::zero(); K];
            let mut value = [E::zero(); K];
            if GEOMETRY {
                value.copy_from_slice(&values[ranks[i] as usize * width + channel..][..K]);
            }
            for pair in pairs.range(i) {
                let Some(image) = image[pairs.pixels[pair] as usize * K..].first_chunk::<K>() else { return };
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
        let pairs = Pairs::<E, false>::gather(p, tile, fresh_transmittance(tile.origin, size));
        let first = tile.origin[1] * size[0];
        for (from, to, len) in tile.rows(size) {
            for x in 0..len {
                transmittance[to - first + x] = pairs.t[from + x].abs();
            }
        }
        let mut channel = 0;
        while channel < width {
            let block = Block { pairs: &pairs, ranks: tile.ranks, values: &values, width, channel };
            channel += block!(width - channel, K => {
                let mut out = vec![E::zero(); PIXELS * K];
                dispatch(BlendBlock::<E, K>(block, &mut out));
                let used = K.min(channels - channel);
                for (from, to, len) in tile.rows(size) {
                    let from = from / STRIDE * TILE;
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
        let to = to / STRIDE * TILE;
        for x in 0..len {
            out[(to + x) * k..][..used].copy_from_slice(&image[(from + x) * channels + channel..][..used]);
        }
    }
    out
}

/// `W^T image`, `[visible, channels]` front to back; `image` is `[H, W, channels]`.
pub(super) fn adjoint<E: Real>(p: &Projected<E>, image: &[E], channels: usize) -> Vec<E> {
    let size = p.size();
    let width = channels.next_multiple_of(ALIGN);
    sum_over_tiles(p, channels, |tile, sums| {
        let pairs = Pairs::<E, false>::gather(p, tile, fresh_transmittance(tile.origin, size));
        let mut channel = 0;
        while channel < width {
            let block = Block { pairs: &pairs, ranks: tile.ranks, values: &[], width, channel };
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

/// What the backward pass over a tile reads besides the projection.
#[derive(Clone, Copy)]
pub(super) struct PixelGradients<'a, E> {
    /// What was rendered, `[H, W, C]`, background included.
    pub image: &'a [E],
    pub transmittance: &'a [E],
    pub d_image: &'a [E],
    pub d_transmittance: Option<&'a [E]>,
}

impl<E: Real> PixelGradients<'_, E> {
    /// `d_image . image + d_transmittance transmittance` of a pixel: the part of the loss's differential that is still
    /// to be shared out before the first Gaussian.
    #[inline(always)]
    pub fn budget(&self, pixel: usize, channels: usize) -> E {
        let at = pixel * channels;
        let mut sum = self.d_transmittance.map_or(E::zero(), |d| d[pixel] * self.transmittance[pixel]);
        for c in 0..channels {
            sum += self.d_image[at + c] * self.image[at + c];
        }
        sum
    }
}

/// Moments (6) and channel gradients of every visible Gaussian, `[visible, 6 + channels]` front to back. `values` is
/// `[N, channels]`.
pub(super) fn backward<E: Real>(
    p: &Projected<E>,
    values: &[E],
    channels: usize,
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    let size = p.size();
    let width = channels.next_multiple_of(ALIGN);
    let stride = 6 + channels;
    let values = p.in_depth_order(values, channels, width);
    sum_over_tiles(p, stride, |tile, sums| {
        let pairs = Pairs::<E, true>::gather(p, tile, fresh_transmittance(tile.origin, size));
        let mut projections = vec![E::zero(); pairs.pixels.len()];
        let mut channel = 0;
        while channel < width {
            let block = Block { pairs: &pairs, ranks: tile.ranks, values: &values, width, channel };
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
                budget[to / STRIDE * TILE + x] = pixels.budget(from + x, channels);
            }
        }
        for (i, sums) in (0..pairs.ends.len()).zip(sums.chunks_exact_mut(stride)) {
            let mut m = [E::zero(); 6];
            for pair in pairs.range(i) {
                let [alpha, u, v] = pairs.shape[pair];
                let own = pairs.weights[pair] * projections[pair];
                let rest = &mut budget[pairs.pixels[pair] as usize];
                *rest -= own;
                if alpha < alpha_max {
                    let g = own - *rest * alpha / (E::one() - alpha);
                    for (m, x) in m.iter_mut().zip([E::one(), u, v, u * u, u * v, v * v]) {
                        *m += g * x;
                    }
                }
            }
            sums[..6].copy_from_slice(&m);
        }
    })
}

/// Six sums as [`Moments`].
pub(super) fn moments<E: Real>(m: &[E]) -> Moments {
    Moments { one: m[0].wide(), u: m[1].wide(), v: m[2].wide(), uu: m[3].wide(), uv: m[4].wide(), vv: m[5].wide() }
}

/// `W` with rows `pixels`; see [`Projected::weights`].
pub(super) fn weights<E: Real>(p: &Projected<E>, pixels: Option<&[u32]>) -> SparseMatrix {
    let [w, h] = p.size();
    let wanted = pixels.map(|pixels| {
        let mut wanted = vec![false; w * h];
        for &pixel in pixels {
            wanted[pixel as usize] = true;
        }
        wanted
    });
    let all = every_row(p, wanted.as_deref());
    let Some(pixels) = pixels else { return all };
    let ascending = pixels.windows(2).all(|w| w[0] < w[1]);
    let mut offsets = Vec::with_capacity(pixels.len() + 1);
    offsets.push(0);
    let mut sum = 0;
    for &pixel in pixels {
        sum += all.row(pixel as usize).0.len();
        offsets.push(offset(sum));
    }
    if ascending {
        return SparseMatrix { offsets, ..all };
    }
    let mut indices = Vec::with_capacity(sum);
    let mut values = Vec::with_capacity(sum);
    for &pixel in pixels {
        let (columns, weights) = all.row(pixel as usize);
        indices.extend_from_slice(columns);
        values.extend_from_slice(weights);
    }
    SparseMatrix { columns: all.columns, offsets, indices, values }
}

/// An entry count as the matrix stores it.
fn offset(count: usize) -> u32 {
    assert!(count <= u32::MAX as usize, "weights: {count} entries exceed 2^32 - 1; ask for fewer pixels");
    count as u32
}

/// `W` with a row for every pixel; rows of pixels not in `wanted` are empty.
fn every_row<E: Real>(p: &Projected<E>, wanted: Option<&[bool]>) -> SparseMatrix {
    let [w, h] = p.size();
    struct Strip {
        /// Entries per pixel.
        counts: Vec<u32>,
        indices: Vec<u32>,
        values: Vec<f32>,
    }
    let strips: Vec<Strip> = (0..p.tiles.rows)
        .into_par_iter()
        .with_max_len(1)
        .map(|row| {
            let height = (h - row * TILE).min(TILE);
            let tiles: Vec<(Tile<'_>, Pairs<E, false>)> = (0..p.tiles.columns)
                .map(|column| {
                    let ranks = &p.tiles.ranks[p.tiles.tile(column, row)];
                    let tile = Tile { origin: [column * TILE, row * TILE], ranks };
                    let mut t = fresh_transmittance(tile.origin, p.size());
                    if let Some(wanted) = wanted {
                        for (to, from, len) in tile.rows(p.size()) {
                            for x in 0..len {
                                if !wanted[from + x] {
                                    t[to + x] = -E::one();
                                }
                            }
                        }
                    }
                    (tile, Pairs::gather(p, tile, t))
                })
                .collect();
            let mut counts = vec![0; w * height];
            for (tile, pairs) in &tiles {
                for &pixel in &pairs.pixels {
                    counts[pixel as usize / TILE * w + tile.origin[0] + pixel as usize % TILE] += 1;
                }
            }
            let mut next = Vec::with_capacity(counts.len());
            let mut sum = 0_u32;
            for count in &counts {
                next.push(sum);
                sum += count;
            }
            let (mut indices, mut values) = (vec![0; sum as usize], vec![0.0; sum as usize]);
            for (tile, pairs) in &tiles {
                for (i, &rank) in tile.ranks.iter().enumerate().take(pairs.ends.len()) {
                    let id = p.ids[rank as usize];
                    let range = pairs.range(i);
                    for (&pixel, weight) in pairs.pixels[range.clone()].iter().zip(&pairs.weights[range]) {
                        let next = &mut next[pixel as usize / TILE * w + tile.origin[0] + pixel as usize % TILE];
                        indices[*next as usize] = id;
                        values[*next as usize] = weight.wide() as f32;
                        *next += 1;
                    }
                }
            }
            Strip { counts, indices, values }
        })
        .collect();
    let total: usize = strips.iter().map(|s| s.indices.len()).sum();
    let mut offsets = Vec::with_capacity(w * h + 1);
    offsets.push(0);
    let (mut indices, mut values) = (Vec::with_capacity(total), Vec::with_capacity(total));
    let mut sum = 0;
    for strip in strips {
        for count in strip.counts {
            sum += count as usize;
            offsets.push(offset(sum));
        }
        indices.extend_from_slice(&strip.indices);
        values.extend_from_slice(&strip.values);
    }
    SparseMatrix { columns: p.len(), offsets, indices, values }
}
