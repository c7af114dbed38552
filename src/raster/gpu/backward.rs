//! Backward pass over the tiles: the kernel.
//!
//! A cube loads [`LOADED`] Gaussians of its tile at a time and takes [`BATCH`] of them together. First every unit is a pixel: it
//! blends them once more, front to back, and leaves `alpha' T` and `g = dL/dalpha' alpha'` in shared memory. Then [`LANES`]
//! units share each Gaussian and sum over all pixels; their sums meet in shared memory again. The sums of a tile entry go to its own
//! row. The rows of a Gaussian are neighbours, and a second kernel adds them. So there are no float atomics, and the bits are the
//! same every time. Everything is linear in the gradient of the image, so that channels come in blocks, and the moments of the
//! blocks add up.

use super::backward_sums::{clear_rows, write_sums};
use super::batch::{BATCH, Exchange, Loaded, Slab, pairs_of};
use super::blend::four_values;
use super::pixel::{
    Four, Light, PATCH, PATCHES, Pixel, Rule, SPLAT_FOURS, pixel, reaches_patch, rule, splat_four,
    take,
};
use super::project::SPLAT;
use crate::backend::gpu::{Gpu, UNITS};
use burn_cubecl::cubecl::{self, prelude::*};

/// Gaussians that a cube loads at a time: waiting for memory takes longer than computing a batch. Shared memory of 32 KB has room
/// for these beside 12 channels.
const LOADED: usize = 3 * BATCH;
/// Channels that make one block on every device: sums of absolute values of more are not sums over blocks.
pub(super) const COMMON_BLOCK_CHANNELS: usize = 8;
/// Widest block with and without moments where shared memory suffices. Chosen by counting registers, not by a measurement.
const WIDEST: [usize; 2] = [24, 32];
// Each unit loads one value at most, and batches are whole.
const _: () = assert!(LOADED.is_multiple_of(BATCH) && LOADED * PATCHES <= UNITS as usize);
const _: () = assert!(LOADED * WIDEST[0] / 4 <= UNITS as usize);

/// Widest block that this device has shared memory for.
pub(super) fn widest(gpu: &Gpu, moments: usize) -> usize {
    let floats = gpu.client.properties().hardware.max_shared_memory_size / size_of::<f32>();
    // What is loaded, patches that a batch touches, and slots.
    let others = pairs_of(moments) + LOADED * (SPLAT + PATCHES + 1) + BATCH * PATCHES + 64;
    let fits = floats.saturating_sub(others) / (UNITS as usize + LOADED) / 4 * 4;
    fits.clamp(COMMON_BLOCK_CHANNELS, WIDEST[usize::from(moments == 0)])
}

/// dL/dS . S + dL/dT T of what lies behind the Gaussians so far.
#[derive(CubeType)]
struct Behind {
    rest: f32,
}

/// Loads the gradient of a block of channels at the unit's pixel, for itself and for the others. Gives its part of dL/dS . S.
#[cube]
fn load_gradient(
    d_own: &mut Array<Four>,
    exchange: &mut Exchange,
    image: &[f32],
    d_image: &[f32],
    own: &Pixel,
    channels: u32,
    first_channel: u32,
    #[comptime] block: usize,
    #[comptime] moments: usize,
) -> f32 {
    let units = comptime![UNITS as usize];
    let end_channel = min(first_channel + block as u32, channels);
    let mut product = 0.0f32;
    #[unroll]
    for k in 0..comptime![block.div_ceil(4)] {
        let mut four = Four::new(0.0f32);
        #[unroll]
        for part in 0..4usize {
            let channel = first_channel + (4 * k + part) as u32;
            if own.inside && channel < end_channel {
                let i = own.index * channels as usize + channel as usize;
                let d = d_image[i];
                four.insert_dynamic(part, d);
                if comptime![moments > 0] {
                    product += d * image[i];
                }
            }
        }
        d_own[k] = four;
        exchange.d_pixels[k * units + UNIT_POS as usize] = four;
    }
    product
}

/// Loads `count` Gaussians of the tile's list from `at` on.
#[cube]
fn load_gaussians(
    loaded: &mut Loaded,
    gaussians: &[u32],
    entries: &[u32],
    splats: &[f32],
    values: &[f32],
    at: usize,
    count: usize,
    tile: usize,
    width: u32,
    height: u32,
    channels: u32,
    first_channel: u32,
    #[comptime] fours: usize,
    #[comptime] moments: usize,
) {
    let unit = UNIT_POS as usize;
    if unit < count * SPLAT_FOURS {
        let id = gaussians[at + unit / SPLAT_FOURS] as usize;
        loaded.splats[unit] = splat_four(splats, id, unit % SPLAT_FOURS);
    }
    if comptime![moments > 0] && unit < count * fours {
        let id = gaussians[at + unit / fours] as usize;
        let channel = first_channel + 4u32 * (unit % fours) as u32;
        loaded.values[unit] = four_values(values, id, channel, channels);
    }
    if unit < count {
        loaded.entries[unit] = entries[at + unit];
    }
    if unit < LOADED * PATCHES {
        let mut reaches = false;
        if unit / PATCHES < count {
            let id = gaussians[at + unit / PATCHES] as usize;
            reaches = reaches_patch(splats, id, tile, (unit % PATCHES) as u32, width, height);
        }
        loaded.reached[unit] = u32::cast_from(reaches);
    }
}

/// Blends the batch that starts at `first` into the unit's pixel and leaves `alpha' T` and g of each Gaussian.
#[cube]
fn replay_batch(
    light: &mut Light,
    behind: &mut Behind,
    exchange: &mut Exchange,
    loaded: &Loaded,
    first: usize,
    d_own: &Array<Four>,
    own: &Pixel,
    rule: &Rule,
    #[comptime] fours: usize,
    #[comptime] moments: usize,
) {
    let unit = UNIT_POS as usize;
    let units = comptime![UNITS as usize];
    let patch = unit / PATCH;
    for j in 0..BATCH {
        let mut weight = 0.0f32;
        let mut g = 0.0f32;
        let reached = loaded.reached[(first + j) * PATCHES + patch] > 0u32;
        if reached && !light.blocked {
            let taken = take(&loaded.splats, first + j, own.x, own.y, light.t, rule);
            if taken.shows {
                if taken.next <= rule.t_min {
                    light.blocked = true;
                } else {
                    let alpha = taken.alpha;
                    weight = alpha * light.t;
                    if comptime![moments > 0] {
                        let mut d = 0.0f32;
                        #[unroll]
                        for k in 0..fours {
                            d += d_own[k].dot(loaded.values[(first + j) * fours + k]);
                        }
                        let share = weight * d;
                        behind.rest -= share;
                        // No gradient passes the cap.
                        if alpha < rule.alpha_max {
                            g = share - behind.rest * (alpha / (1.0f32 - alpha));
                        }
                    }
                    light.t = taken.next;
                    exchange.touched[j * PATCHES + patch].store(1u32);
                }
            }
        }
        if reached {
            exchange.pairs[j * units + unit] = weight;
            if comptime![moments > 0] {
                exchange.pairs[(BATCH + j) * units + unit] = g;
            }
        }
    }
}

#[cube(launch)]
pub(super) fn tiles_backward(
    ranges: &[u32],
    gaussians: &[u32],
    entries: &[u32],
    splats: &[f32],
    values: &[f32],
    view: &[f32],
    image: &[f32],
    d_image: &[f32],
    transmittance: &[f32],
    d_transmittance: &[f32],
    rows: &mut [f32],
    width: u32,
    height: u32,
    tiles: u32,
    channels: u32,
    first_channel: u32,
    first_entry: u32,
    end_entry: u32,
    #[comptime] block: usize,
    #[comptime] moments: usize,
    #[comptime] with_transmittance: bool,
) {
    let tile = CUBE_POS;
    if tile >= tiles as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let columns = comptime![moments + block];
    let units = comptime![UNITS as usize];
    let fours = comptime![block.div_ceil(4)];
    let mut loaded = Loaded {
        splats: Shared::<[Four]>::new_slice(LOADED * SPLAT_FOURS),
        values: Shared::<[Four]>::new_slice(LOADED * fours),
        entries: Shared::<[u32]>::new_slice(LOADED),
        reached: Shared::<[u32]>::new_slice(LOADED * PATCHES),
    };
    let mut exchange = Exchange {
        d_pixels: Shared::<[Four]>::new_slice(units * fours),
        pairs: Shared::<[f32]>::new_slice(comptime![pairs_of(moments)]),
        touched: Shared::<[Atomic<u32>]>::new_slice(BATCH * PATCHES),
        live: Shared::<[Atomic<u32>]>::new_slice(3usize),
    };
    let slab = Slab {
        first: first_entry,
        end: end_entry,
    };
    let rule = rule(view);
    let own = pixel(tile, UNIT_POS, width, height);
    let origin = pixel(tile, 0u32, width, height);
    let mut light = Light {
        t: 1.0f32,
        blocked: !own.inside,
    };
    let mut d_own = Array::<Four>::new(fours);
    let mut behind = Behind {
        rest: load_gradient(
            &mut d_own,
            &mut exchange,
            image,
            d_image,
            &own,
            channels,
            first_channel,
            block,
            moments,
        ),
    };
    if comptime![with_transmittance] && own.inside {
        behind.rest += d_transmittance[own.index] * transmittance[own.index];
    }
    if unit == 0 {
        exchange.live[0].store(0u32);
    }
    if unit < BATCH * PATCHES {
        exchange.touched[unit].store(0u32);
    }

    let mut at = ranges[2 * tile] as usize;
    let mut end = ranges[2 * tile + 1] as usize;
    let mut slot = 0usize;
    while at < end {
        // Entries of a tile ascend: those beyond the slab are another pass's, and of those before it only what they leave of the
        // light counts.
        if entries[at] >= slab.end {
            end = at;
        }
        let count = min(end - at, LOADED);
        load_gaussians(
            &mut loaded,
            gaussians,
            entries,
            splats,
            values,
            at,
            count,
            tile,
            width,
            height,
            channels,
            first_channel,
            fours,
            moments,
        );
        sync_cube();

        let mut first = 0usize;
        while first < count {
            let members = min(count - first, BATCH);
            let before_slab = loaded.entries[first + members - 1] < slab.first;
            let in_slab = !before_slab && loaded.entries[first] < slab.end;
            let next_slot = (slot + 1) % 3;
            if unit == 0 {
                exchange.live[next_slot].store(0u32);
            }
            replay_batch(
                &mut light,
                &mut behind,
                &mut exchange,
                &loaded,
                first,
                &d_own,
                &own,
                &rule,
                fours,
                moments,
            );
            if !light.blocked {
                exchange.live[slot].store(1u32);
            }
            sync_cube();

            if in_slab {
                write_sums(
                    rows,
                    &mut exchange,
                    &loaded,
                    first,
                    members,
                    &origin,
                    &slab,
                    block,
                    moments,
                );
            }
            if unit < BATCH * PATCHES {
                exchange.touched[unit].store(0u32);
            }
            first += members;
            let going = exchange.live[slot].load();
            slot = next_slot;
            sync_cube();
            if going == 0u32 {
                clear_rows(rows, entries, at + first, end, &slab, columns);
                end = at;
                first = count;
            }
        }
        at += count;
    }
}
