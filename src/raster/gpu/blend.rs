//! Forward blending: one cube for each tile, one unit for each pixel, a block of channels in registers.

use super::lists::tile_counts;
use super::pixel::{
    Four, PATCH, PATCHES, SPLAT_FOURS, pixel, reaches_patch, rule, splat_four, take,
};
use super::prepare::Prepared;
use super::view::BACKGROUND;
use crate::backend::gpu::{Gpu, UNITS, arg};
use burn::tensor::Shape;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Gaussians that a cube loads together: [`WORDS`] words with a bit for each.
const BATCH: usize = WORDS * 32;
const WORDS: usize = 2;
/// Words of one batch.
const MASKS: usize = PATCHES * WORDS;
/// Widest block of channels.
const WIDEST: usize = 32;

/// Values `[N, channels]` of Gaussian `id` in four channels from `channel` on; zeros after the last.
#[cube]
pub(super) fn four_values(values: &[f32], id: usize, channel: u32, channels: u32) -> Four {
    let mut four = Four::empty();
    #[unroll]
    for k in 0..4usize {
        let mut value = 0.0f32;
        if channel + (k as u32) < channels {
            value = values[id * channels as usize + channel as usize + k];
        }
        four.insert(k, value);
    }
    four
}

#[cube(launch)]
fn blend_tiles(
    ranges: &[u32],
    gaussians: &[u32],
    splats: &[f32],
    all_values: &[f32],
    view: &[f32],
    image: &mut [f32],
    transmittance: &mut [f32],
    width: u32,
    height: u32,
    tiles: u32,
    channels: u32,
    first_channel: u32,
    #[comptime] block: usize,
    #[comptime] with_transmittance: bool,
) {
    let tile = CUBE_POS;
    if tile >= tiles as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let fours = comptime![block.div_ceil(4)];
    let mut batch = Shared::<[Four]>::new_slice(BATCH * SPLAT_FOURS);
    let mut values = Shared::<[Four]>::new_slice(BATCH * fours);
    // Whether some unit still blends: written to one slot while another is read and the third is cleared.
    let live = Shared::<[Atomic<u32>]>::new_slice(3usize);
    // The Gaussians that may show in each patch, in the same slots.
    let masks = Shared::<[Atomic<u32>]>::new_slice(3 * MASKS);
    let patch = unit / PATCH;
    let rule = rule(view);
    let own = pixel(tile, UNIT_POS, width, height);
    let mut done = !own.inside;
    let mut t = 1.0f32;
    let mut sums = Array::<Four>::new(fours);
    #[unroll]
    for k in 0..fours {
        sums[k] = Four::new(0.0f32);
    }
    if unit == 0 {
        live[0].store(0u32);
    }
    if unit < MASKS {
        masks[unit].store(0u32);
    }
    sync_cube();
    let mut at = ranges[2 * tile];
    let end = ranges[2 * tile + 1];
    let mut slot = 0u32;
    while at < end {
        let count = min(end - at, BATCH as u32);
        let mut k = unit;
        while k < count as usize * SPLAT_FOURS {
            let id = gaussians[at as usize + k / SPLAT_FOURS] as usize;
            batch[k] = splat_four(splats, id, k % SPLAT_FOURS);
            k += UNITS as usize;
        }
        k = unit;
        while k < count as usize * fours {
            let id = gaussians[at as usize + k / fours] as usize;
            let channel = first_channel + 4u32 * (k % fours) as u32;
            values[k] = four_values(all_values, id, channel, channels);
            k += UNITS as usize;
        }
        let next_slot = ((slot + 1u32) % 3u32) as usize;
        if unit == 0 {
            live[next_slot].store(0u32);
        }
        if unit < MASKS {
            masks[next_slot * MASKS + unit].store(0u32);
        }
        #[unroll]
        for word in 0..WORDS {
            // Neighbouring units ask for different patches, whose words do not get in each other's way.
            let bit = unit / PATCHES;
            let j = word * 32 + bit;
            if j < count as usize {
                let id = gaussians[at as usize + j] as usize;
                if reaches_patch(splats, id, tile, (unit % PATCHES) as u32, width, height) {
                    masks[slot as usize * MASKS + word * PATCHES + unit % PATCHES]
                        .fetch_or(1u32 << bit as u32);
                }
            }
        }
        sync_cube();
        #[unroll]
        for word in 0..WORDS {
            let mut mask = masks[slot as usize * MASKS + word * PATCHES + patch].load();
            while mask != 0u32 && !done {
                let j = word * 32 + mask.trailing_zeros() as usize;
                mask &= mask - 1u32;
                let taken = take(&batch, j, own.x, own.y, t, &rule);
                if taken.shows {
                    if taken.next <= rule.t_min {
                        done = true;
                    } else {
                        let weight = Four::new(taken.alpha * t);
                        #[unroll]
                        for k in 0..fours {
                            sums[k] += weight * values[j * fours + k];
                        }
                        t = taken.next;
                    }
                }
            }
        }
        if !done {
            live[slot as usize].store(1u32);
        }
        sync_cube();
        at += count;
        if live[slot as usize].load() == 0u32 {
            at = end;
        }
        slot = (slot + 1u32) % 3u32;
    }
    if own.inside {
        #[unroll]
        for k in 0..block {
            let channel = first_channel + k as u32;
            if channel < channels {
                let mut value = sums[k / 4].extract_dynamic(k % 4);
                if channel < 3u32 {
                    value += t * view[BACKGROUND + channel as usize];
                }
                image[own.index * channels as usize + channel as usize] = value;
            }
        }
        if comptime![with_transmittance] {
            transmittance[own.index] = t;
        }
    }
}

/// First channel and width of the blocks that `channels` are cut into: `widest` at most, the last one a multiple of 4
/// (so that few kernels are compiled) when above 4.
pub(super) fn blocks(channels: usize, widest: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..channels)
        .step_by(widest)
        .map(move |first| match channels - first {
            left @ 0..=4 => (first, left),
            left => (first, left.next_multiple_of(4).min(widest)),
        })
}

/// Image `[H, W, channels]` of `values` `[N, channels]`, background included, and transmittance `[H, W]`.
pub(super) fn blend(
    gpu: &Gpu,
    prepared: &Prepared,
    values: &CubeTensor,
    channels: usize,
) -> (CubeTensor, CubeTensor) {
    let Prepared { view, entries, .. } = prepared;
    let splats = &prepared.projected.splats;
    let [w, h] = prepared.size;
    let tiles: usize = tile_counts(prepared.size).iter().product();
    let image = gpu.floats(Shape::new([h, w, channels]));
    let transmittance = gpu.floats(Shape::new([h, w]));
    for (first, block) in blocks(channels, WIDEST) {
        blend_tiles::launch(
            &gpu.client,
            gpu.cubes(tiles),
            gpu.dim(),
            arg(&entries.ranges),
            arg(&entries.gaussians),
            arg(splats),
            arg(values),
            arg(view),
            arg(&image),
            arg(&transmittance),
            w as u32,
            h as u32,
            tiles as u32,
            channels as u32,
            first as u32,
            block,
            first == 0,
        );
    }
    (image, transmittance)
}
