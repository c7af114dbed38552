//! Backward pass over the tiles: the kernel.
//!
//! A cube loads [`LOADED`] Gaussians of its tile at a time and takes [`BATCH`] of them together. First every unit is a pixel: it
//! blends them once more, front to back, and leaves `alpha' T` and `g = dL/dalpha' alpha'` in shared memory. Then [`LANES`] units
//! share a Gaussian and sum over all pixels; their sums meet in shared memory again. The sums of a tile entry go to its own row. The
//! rows of a Gaussian are neighbours, and a second kernel adds them. So there are no float atomics, and the bits are the same every
//! time. Everything is linear in the gradient of the image, so that channels come in blocks, and the moments of the blocks add up.

use super::blend::four_values;
use super::pixel::{
    Four, PATCH, PATCH_HEIGHT, PATCH_WIDTH, PATCHES, PATCHES_ACROSS, SPLAT_FOURS, pixel,
    reaches_patch, rule, splat_four, take,
};
use super::project::SPLAT;
use crate::backend::gpu::{Gpu, UNITS};
use burn_cubecl::cubecl::{self, prelude::*};

/// Sums over pixels of g times 1, u, v, u^2, u v, v^2.
pub(super) const MOMENTS: usize = 6;
/// These, and the sums over pixels of the absolute contributions to half the gradient of the projected centre, along x in units
/// of the inverse width: `|g u|`, `|g (v dv - slope u du)|`.
pub(super) const ABSOLUTE_MOMENTS: usize = 8;
/// Gaussians that a cube takes together.
const BATCH: usize = 8;
/// Gaussians that a cube loads at a time: waiting for memory takes longer than computing a batch. Shared memory of 32 KB has room
/// for these beside 12 channels.
const LOADED: usize = 3 * BATCH;
/// Units that sum for one Gaussian.
const LANES: usize = UNITS as usize / BATCH;
/// They are as many as the pixels of a patch.
const _: () = assert!(LANES == PATCH);
/// Channels that make one block on every device: sums of absolute values of more are not sums over blocks.
pub(super) const COMMON_BLOCK_CHANNELS: usize = 8;
/// Widest block with and without moments where shared memory suffices. Chosen by counting registers, not by a measurement.
const WIDEST: [usize; 2] = [24, 32];
// Each unit loads one value at most, and batches are whole.
const _: () = assert!(LOADED.is_multiple_of(BATCH) && LOADED * PATCHES <= UNITS as usize);
const _: () = assert!(LOADED * WIDEST[0] / 4 <= UNITS as usize);

/// Floats that all units of a cube leave for each other: alpha' T and, for the moments, g of every pixel of a batch.
const fn pairs_of(moments: usize) -> usize {
    (if moments > 0 { 2 } else { 1 }) * BATCH * UNITS as usize
}

/// Widest block that this device has shared memory for.
pub(super) fn widest(gpu: &Gpu, moments: usize) -> usize {
    let floats = gpu.client.properties().hardware.max_shared_memory_size / size_of::<f32>();
    // What is loaded, patches that a batch touches, and slots.
    let others = pairs_of(moments) + LOADED * (SPLAT + PATCHES + 1) + BATCH * PATCHES + 64;
    let fits = floats.saturating_sub(others) / (UNITS as usize + LOADED) / 4 * 4;
    fits.clamp(COMMON_BLOCK_CHANNELS, WIDEST[usize::from(moments == 0)])
}

/// How a projected Gaussian lies in the image: `u = du (x - slope y)` and `v = dv y` of a pixel that is `x` and `y` from its centre.
#[derive(CubeType)]
struct Axes {
    slope: f32,
    du: f32,
    dv: f32,
}

/// Adds to the moments what a pixel with the gradient `g`, `x` and `y` from the centre, contributes.
#[cube]
fn add_moments(
    sums: &mut Array<f32>,
    g: f32,
    x: f32,
    y: f32,
    axes: &Axes,
    #[comptime] moments: usize,
) {
    let u = axes.du * (x - axes.slope * y);
    let v = axes.dv * y;
    sums[0] += g;
    sums[1] += g * u;
    sums[2] += g * v;
    sums[3] += g * u * u;
    sums[4] += g * u * v;
    sums[5] += g * v * v;
    if comptime![moments == ABSOLUTE_MOMENTS] {
        sums[6] += (g * u).abs();
        sums[7] += (g * (v * axes.dv - axes.slope * (u * axes.du))).abs();
    }
}

#[cube(launch)]
pub(super) fn tiles_backward(
    ranges: &[u32],
    gaussians: &[u32],
    entries: &[u32],
    splats: &[f32],
    all_values: &[f32],
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
    // Columns that are summed together where the pairs were, and how often that is.
    let rounds = comptime![columns.div_ceil(pairs_of(moments) / UNITS as usize)];
    let together = comptime![columns.div_ceil(rounds)];
    let fours = comptime![block.div_ceil(4)];
    let mut loaded = Shared::<[Four]>::new_slice(LOADED * SPLAT_FOURS);
    let mut values = Shared::<[Four]>::new_slice(LOADED * fours);
    let mut d_pixels = Shared::<[Four]>::new_slice(units * fours);
    let mut pairs = Shared::<[f32]>::new_slice(comptime![pairs_of(moments)]);
    let mut loaded_entries = Shared::<[u32]>::new_slice(LOADED);
    // Whether a Gaussian may show in a patch, and whether it contributes to a pixel of the patch.
    let mut reached = Shared::<[u32]>::new_slice(LOADED * PATCHES);
    let touched = Shared::<[Atomic<u32>]>::new_slice(BATCH * PATCHES);
    let live = Shared::<[Atomic<u32>]>::new_slice(3usize);
    let rule = rule(view);
    let own = pixel(tile, UNIT_POS, width, height);
    let mut done = !own.inside;
    let mut t = 1.0f32;
    // The rest of dL/dS . S + dL/dT T after the Gaussians so far.
    let mut rest = 0.0f32;
    let mut d_own = Array::<Four>::new(fours);
    #[unroll]
    for k in 0..fours {
        let mut four = Four::new(0.0f32);
        #[unroll]
        for part in 0..4usize {
            let channel = first_channel + (4 * k + part) as u32;
            if own.inside && channel < min(first_channel + block as u32, channels) {
                let i = own.index * channels as usize + channel as usize;
                let d = d_image[i];
                four.insert_dynamic(part, d);
                if comptime![moments > 0] {
                    rest += d * image[i];
                }
            }
        }
        d_own[k] = four;
        d_pixels[k * units + unit] = four;
    }
    if comptime![with_transmittance] && own.inside {
        rest += d_transmittance[own.index] * transmittance[own.index];
    }
    if unit == 0 {
        live[0].store(0u32);
    }
    if unit < BATCH * PATCHES {
        touched[unit].store(0u32);
    }
    let patch = unit / PATCH;
    // The pixels that this unit sums over: the same one of every patch.
    let member = unit / LANES;
    let lane = unit % LANES;
    let origin = pixel(tile, 0u32, width, height);
    let lane_x = origin.x + f32::cast_from((lane % PATCH_WIDTH) as u32);
    let lane_y = origin.y + f32::cast_from((lane / PATCH_WIDTH) as u32);

    let mut at = ranges[2 * tile];
    let mut end = ranges[2 * tile + 1];
    let mut slot = 0u32;
    while at < end {
        // Entries of a tile ascend: those beyond the slab are another pass's, and of those before it only what they leave of the
        // light counts.
        if entries[at as usize] >= end_entry {
            end = at;
        }
        let count = min(end - at, LOADED as u32) as usize;
        if unit < count * SPLAT_FOURS {
            let id = gaussians[at as usize + unit / SPLAT_FOURS] as usize;
            loaded[unit] = splat_four(splats, id, unit % SPLAT_FOURS);
        }
        if comptime![moments > 0] && unit < count * fours {
            let id = gaussians[at as usize + unit / fours] as usize;
            let channel = first_channel + 4u32 * (unit % fours) as u32;
            values[unit] = four_values(all_values, id, channel, channels);
        }
        if unit < count {
            loaded_entries[unit] = entries[at as usize + unit];
        }
        if unit < LOADED * PATCHES {
            let mut reaches = false;
            if unit / PATCHES < count {
                let id = gaussians[at as usize + unit / PATCHES] as usize;
                reaches = reaches_patch(splats, id, tile, (unit % PATCHES) as u32, width, height);
            }
            reached[unit] = u32::cast_from(reaches);
        }
        sync_cube();

        let mut first = 0usize;
        while first < count {
            let members = min(count - first, BATCH);
            let before_slab = loaded_entries[first + members - 1] < first_entry;
            let in_slab = !before_slab && loaded_entries[first] < end_entry;
            let next_slot = (slot + 1u32) % 3u32;
            if unit == 0 {
                live[next_slot as usize].store(0u32);
            }
            for j in 0..BATCH {
                let mut weight = 0.0f32;
                let mut g = 0.0f32;
                let reached = reached[(first + j) * PATCHES + patch] > 0u32;
                if reached && !done {
                    let taken = take(&loaded, first + j, own.x, own.y, t, &rule);
                    if taken.shows {
                        if taken.next <= rule.t_min {
                            done = true;
                        } else {
                            let alpha = taken.alpha;
                            weight = alpha * t;
                            if comptime![moments > 0] {
                                let mut d = 0.0f32;
                                #[unroll]
                                for k in 0..fours {
                                    d += d_own[k].dot(values[(first + j) * fours + k]);
                                }
                                let share = weight * d;
                                rest -= share;
                                // No gradient passes the cap.
                                if alpha < rule.alpha_max {
                                    g = share - rest * (alpha / (1.0f32 - alpha));
                                }
                            }
                            t = taken.next;
                            touched[j * PATCHES + patch].store(1u32);
                        }
                    }
                }
                if reached {
                    pairs[j * units + unit] = weight;
                    if comptime![moments > 0] {
                        pairs[(BATCH + j) * units + unit] = g;
                    }
                }
            }
            if !done {
                live[slot as usize].store(1u32);
            }
            sync_cube();

            if in_slab {
                let mut sums = Array::<f32>::new(rounds * together);
                #[unroll]
                for k in 0..rounds * together {
                    sums[k] = 0.0f32;
                }
                let mut value_sums = Array::<Four>::new(fours);
                #[unroll]
                for k in 0..fours {
                    value_sums[k] = Four::new(0.0f32);
                }
                let splat = loaded[(first + member) * SPLAT_FOURS];
                let axes = Axes {
                    slope: splat.extract(2usize),
                    du: splat.extract(3usize),
                    dv: loaded[(first + member) * SPLAT_FOURS + 1].extract(0usize),
                };
                let dx = lane_x - splat.extract(0usize);
                let dy = lane_y - splat.extract(1usize);
                for i in 0..PATCHES {
                    if touched[member * PATCHES + i].load() > 0u32 {
                        let at_pixel = i * PATCH + lane;
                        if comptime![moments > 0] {
                            let g = pairs[(BATCH + member) * units + at_pixel];
                            let row =
                                dy + f32::cast_from(((i / PATCHES_ACROSS) * PATCH_HEIGHT) as u32);
                            let column =
                                dx + f32::cast_from(((i % PATCHES_ACROSS) * PATCH_WIDTH) as u32);
                            add_moments(&mut sums, g, column, row, &axes, moments);
                        }
                        let weight = Four::new(pairs[member * units + at_pixel]);
                        #[unroll]
                        for k in 0..fours {
                            value_sums[k] += weight * d_pixels[k * units + at_pixel];
                        }
                    }
                }
                #[unroll]
                for k in 0..block {
                    sums[moments + k] = value_sums[k / 4].extract_dynamic(k % 4);
                }
                #[unroll]
                for round in 0..rounds {
                    sync_cube();
                    #[unroll]
                    for k in 0..together {
                        pairs[k * units + unit] = sums[round * together + k];
                    }
                    sync_cube();
                    let sum_of = unit / together;
                    let column = round * together + unit % together;
                    if sum_of < members && column < columns {
                        let mut sum = 0.0f32;
                        for i in 0..LANES {
                            // Each unit starts elsewhere, so that no two of a warp meet in a memory bank.
                            sum += pairs
                                [(unit % together) * units + sum_of * LANES + (i + unit) % LANES];
                        }
                        let entry = loaded_entries[first + sum_of];
                        if entry >= first_entry && entry < end_entry {
                            rows[(entry - first_entry) as usize * columns + column] = sum;
                        }
                    }
                }
            }
            if unit < BATCH * PATCHES {
                touched[unit].store(0u32);
            }
            first += members;
            let going = live[slot as usize].load();
            slot = next_slot;
            sync_cube();
            if going == 0u32 {
                // No light reaches the rest of the list.
                let from = at as usize + first;
                let left = (end as usize - from) * columns;
                let mut k = unit;
                while k < left {
                    let entry = entries[from + k / columns];
                    if entry >= first_entry && entry < end_entry {
                        rows[(entry - first_entry) as usize * columns + k % columns] = 0.0f32;
                    }
                    k += units;
                }
                end = at;
                first = count;
            }
        }
        at += count as u32;
    }
}
