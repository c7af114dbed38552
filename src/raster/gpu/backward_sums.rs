//! Backward pass over the tiles: sums over the pixels of a tile, and the rows that they go to.

use super::batch::{ABSOLUTE_MOMENTS, BATCH, Exchange, LANES, Loaded, Slab, pairs_of};
use super::pixel::{
    Four, PATCH, PATCH_HEIGHT, PATCH_WIDTH, PATCHES, PATCHES_ACROSS, Pixel, SPLAT_FOURS,
};
use crate::backend::gpu::UNITS;
use burn_cubecl::cubecl::{self, prelude::*};

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

/// Whether the slab has the entry.
#[cube]
fn contains(slab: &Slab, entry: u32) -> bool {
    entry >= slab.first && entry < slab.end
}

/// Sums the columns of one Gaussian of the batch over the unit's pixels: the same lane of every patch.
#[cube]
fn sum_patches(
    sums: &mut Array<f32>,
    exchange: &mut Exchange,
    loaded: &Loaded,
    first: usize,
    origin: &Pixel,
    #[comptime] block: usize,
    #[comptime] moments: usize,
) {
    let units = comptime![UNITS as usize];
    let fours = comptime![block.div_ceil(4)];
    let member = UNIT_POS as usize / LANES;
    let lane = UNIT_POS as usize % LANES;
    let mut value_sums = Array::<Four>::new(fours);
    #[unroll]
    for k in 0..fours {
        value_sums[k] = Four::new(0.0f32);
    }
    let splat = loaded.splats[(first + member) * SPLAT_FOURS];
    let axes = Axes {
        slope: splat.extract(2usize),
        du: splat.extract(3usize),
        dv: loaded.splats[(first + member) * SPLAT_FOURS + 1].extract(0usize),
    };
    let lane_x = origin.x + f32::cast_from((lane % PATCH_WIDTH) as u32);
    let lane_y = origin.y + f32::cast_from((lane / PATCH_WIDTH) as u32);
    let dx = lane_x - splat.extract(0usize);
    let dy = lane_y - splat.extract(1usize);
    for i in 0..PATCHES {
        if exchange.touched[member * PATCHES + i].load() > 0u32 {
            let pixel = i * PATCH + lane;
            if comptime![moments > 0] {
                let g = exchange.pairs[(BATCH + member) * units + pixel];
                let y = dy + f32::cast_from(((i / PATCHES_ACROSS) * PATCH_HEIGHT) as u32);
                let x = dx + f32::cast_from(((i % PATCHES_ACROSS) * PATCH_WIDTH) as u32);
                add_moments(sums, g, x, y, &axes, moments);
            }
            let weight = Four::new(exchange.pairs[member * units + pixel]);
            #[unroll]
            for k in 0..fours {
                value_sums[k] += weight * exchange.d_pixels[k * units + pixel];
            }
        }
    }
    #[unroll]
    for k in 0..block {
        sums[moments + k] = value_sums[k / 4].extract_dynamic(k % 4);
    }
}

/// Adds the sums of the lanes and writes the rows of the batch's `members` Gaussians. All units take part.
#[cube]
fn write_rows(
    rows: &mut [f32],
    exchange: &mut Exchange,
    sums: &Array<f32>,
    loaded: &Loaded,
    first: usize,
    members: usize,
    slab: &Slab,
    #[comptime] columns: usize,
    #[comptime] together: usize,
) {
    let unit = UNIT_POS as usize;
    let units = comptime![UNITS as usize];
    #[unroll]
    for round in 0..comptime![columns.div_ceil(together)] {
        sync_cube();
        #[unroll]
        for k in 0..together {
            exchange.pairs[k * units + unit] = sums[round * together + k];
        }
        sync_cube();
        let member = unit / together;
        let column = round * together + unit % together;
        if member < members && column < columns {
            let from = (unit % together) * units + member * LANES;
            let mut sum = 0.0f32;
            for i in 0..LANES {
                // Each unit starts elsewhere, so that no two of a warp meet in a memory bank.
                sum += exchange.pairs[from + (i + unit) % LANES];
            }
            let entry = loaded.entries[first + member];
            if contains(slab, entry) {
                rows[(entry - slab.first) as usize * columns + column] = sum;
            }
        }
    }
}

/// Sums over the pixels of the tile for the `members` Gaussians of the batch that starts at `first`, and writes their rows.
#[cube]
pub(super) fn write_sums(
    rows: &mut [f32],
    exchange: &mut Exchange,
    loaded: &Loaded,
    first: usize,
    members: usize,
    origin: &Pixel,
    slab: &Slab,
    #[comptime] block: usize,
    #[comptime] moments: usize,
) {
    let columns = comptime![moments + block];
    // Columns that are summed together where the pairs were, and how often that is.
    let rounds = comptime![columns.div_ceil(pairs_of(moments) / UNITS as usize)];
    let together = comptime![columns.div_ceil(rounds)];
    let mut sums = Array::<f32>::new(rounds * together);
    #[unroll]
    for k in 0..rounds * together {
        sums[k] = 0.0f32;
    }
    sum_patches(&mut sums, exchange, loaded, first, origin, block, moments);
    write_rows(
        rows, exchange, &sums, loaded, first, members, slab, columns, together,
    );
}

/// Writes zeros to the rows of the list's entries `from..end`, which no light reaches.
#[cube]
pub(super) fn clear_rows(
    rows: &mut [f32],
    entries: &[u32],
    from: usize,
    end: usize,
    slab: &Slab,
    #[comptime] columns: usize,
) {
    let mut k = UNIT_POS as usize;
    while k < (end - from) * columns {
        let entry = entries[from + k / columns];
        if contains(slab, entry) {
            rows[(entry - slab.first) as usize * columns + k % columns] = 0.0f32;
        }
        k += UNITS as usize;
    }
}
