//! Forward blending: one cube for each tile, one unit for each pixel, a block of channels in registers.

use super::lists::tile_counts;
use super::pixel::{
    Four, Light, PATCH, PATCHES, Pixel, Rule, SPLAT_FOURS, pixel, reaches_patch, rule, splat_four,
    take,
};
use super::prepare::Prepared;
use super::view::BACKGROUND;
use crate::backend::gpu::{Gpu, UNITS, launch};
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

/// The Gaussians that a cube has loaded.
#[derive(CubeType)]
struct Batch {
    splats: Shared<[Four]>,
    values: Shared<[Four]>,
}

/// Flags that the units of a cube share. Each has three slots: one is written while another is read and the third is cleared.
#[derive(CubeType)]
struct Signals {
    /// Whether some unit still blends.
    live: Shared<[Atomic<u32>]>,
    /// The Gaussians of the batch that may show in each patch: a bit for each.
    masks: Shared<[Atomic<u32>]>,
}

/// Makes a slot ready for the next batch: no unit blends, and no Gaussian shows.
#[cube]
fn clear_slot(signals: &Signals, slot: usize, unit: usize) {
    if unit == 0 {
        signals.live[slot].store(0u32);
    }
    if unit < MASKS {
        signals.masks[slot * MASKS + unit].store(0u32);
    }
}

/// Loads `count` Gaussians of the list from `at` on, with the channels from `first_channel` on.
#[cube]
fn load_batch(
    batch: &mut Batch,
    gaussians: &[u32],
    splats: &[f32],
    values: &[f32],
    at: usize,
    count: usize,
    first_channel: u32,
    channels: u32,
    #[comptime] fours: usize,
) {
    let mut k = UNIT_POS as usize;
    while k < count * SPLAT_FOURS {
        let id = gaussians[at + k / SPLAT_FOURS] as usize;
        batch.splats[k] = splat_four(splats, id, k % SPLAT_FOURS);
        k += UNITS as usize;
    }
    k = UNIT_POS as usize;
    while k < count * fours {
        let id = gaussians[at + k / fours] as usize;
        let channel = first_channel + 4u32 * (k % fours) as u32;
        batch.values[k] = four_values(values, id, channel, channels);
        k += UNITS as usize;
    }
}

/// Notes in `slot` which of the `count` Gaussians from `at` on may show in which patch of the tile.
#[cube]
fn mark_patches(
    signals: &Signals,
    slot: usize,
    gaussians: &[u32],
    splats: &[f32],
    at: usize,
    count: usize,
    tile: usize,
    width: u32,
    height: u32,
) {
    // Neighbouring units test different patches, so that their atomic operations go to different words.
    let unit = UNIT_POS as usize;
    let patch = unit % PATCHES;
    let bit = unit / PATCHES;
    #[unroll]
    for word in 0..WORDS {
        let j = word * 32 + bit;
        if j < count {
            let id = gaussians[at + j] as usize;
            if reaches_patch(splats, id, tile, patch as u32, width, height) {
                signals.masks[slot * MASKS + word * PATCHES + patch].fetch_or(1u32 << bit as u32);
            }
        }
    }
}

/// Blends the Gaussians of the batch that may show in the unit's patch, front to back, until no light passes.
#[cube]
fn blend_batch(
    sums: &mut Array<Four>,
    light: &mut Light,
    batch: &Batch,
    signals: &Signals,
    slot: usize,
    own: &Pixel,
    rule: &Rule,
    #[comptime] fours: usize,
) {
    let patch = UNIT_POS as usize / PATCH;
    #[unroll]
    for word in 0..WORDS {
        let mut mask = signals.masks[slot * MASKS + word * PATCHES + patch].load();
        while mask != 0u32 && !light.blocked {
            let j = word * 32 + mask.trailing_zeros() as usize;
            mask &= mask - 1u32;
            let taken = take(&batch.splats, j, own.x, own.y, light.t, rule);
            if taken.shows {
                if taken.next <= rule.t_min {
                    light.blocked = true;
                } else {
                    let weight = Four::new(taken.alpha * light.t);
                    #[unroll]
                    for k in 0..fours {
                        sums[k] += weight * batch.values[j * fours + k];
                    }
                    light.t = taken.next;
                }
            }
        }
    }
}

/// Writes a block of channels of a pixel, with the background behind the first three.
#[cube]
fn write_pixel(
    image: &mut [f32],
    sums: &Array<Four>,
    t: f32,
    view: &[f32],
    index: usize,
    channels: u32,
    first_channel: u32,
    #[comptime] block: usize,
) {
    #[unroll]
    for k in 0..block {
        let channel = first_channel + k as u32;
        if channel < channels {
            let mut value = sums[k / 4].extract_dynamic(k % 4);
            if channel < 3u32 {
                value += t * view[BACKGROUND + channel as usize];
            }
            image[index * channels as usize + channel as usize] = value;
        }
    }
}

#[cube(launch)]
fn blend_tiles(
    ranges: &[u32],
    gaussians: &[u32],
    splats: &[f32],
    values: &[f32],
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
    let mut batch = Batch {
        splats: Shared::<[Four]>::new_slice(BATCH * SPLAT_FOURS),
        values: Shared::<[Four]>::new_slice(BATCH * fours),
    };
    let signals = Signals {
        live: Shared::<[Atomic<u32>]>::new_slice(3usize),
        masks: Shared::<[Atomic<u32>]>::new_slice(3 * MASKS),
    };
    let rule = rule(view);
    let own = pixel(tile, UNIT_POS, width, height);
    let mut light = Light {
        t: 1.0f32,
        blocked: !own.inside,
    };
    let mut sums = Array::<Four>::new(fours);
    #[unroll]
    for k in 0..fours {
        sums[k] = Four::new(0.0f32);
    }
    clear_slot(&signals, 0usize, unit);
    sync_cube();

    let mut at = ranges[2 * tile] as usize;
    let end = ranges[2 * tile + 1] as usize;
    let mut slot = 0usize;
    while at < end {
        let count = min(end - at, BATCH);
        let next_slot = (slot + 1) % 3;
        load_batch(
            &mut batch,
            gaussians,
            splats,
            values,
            at,
            count,
            first_channel,
            channels,
            fours,
        );
        clear_slot(&signals, next_slot, unit);
        mark_patches(
            &signals, slot, gaussians, splats, at, count, tile, width, height,
        );
        sync_cube();
        blend_batch(
            &mut sums, &mut light, &batch, &signals, slot, &own, &rule, fours,
        );
        if !light.blocked {
            signals.live[slot].store(1u32);
        }
        sync_cube();
        at += count;
        if signals.live[slot].load() == 0u32 {
            at = end;
        }
        slot = next_slot;
    }

    if own.inside {
        write_pixel(
            image,
            &sums,
            light.t,
            view,
            own.index,
            channels,
            first_channel,
            block,
        );
        if comptime![with_transmittance] {
            transmittance[own.index] = light.t;
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
        launch!(gpu, blend_tiles, gpu.cubes(tiles);
            &entries.ranges, &entries.gaussians, splats, values, view, &image, &transmittance;
            w as u32, h as u32, tiles as u32, channels as u32, first as u32, block, first == 0);
    }
    (image, transmittance)
}
