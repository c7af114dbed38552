//! Sums over the tiles of each Gaussian. Each tile entry has a row; the rows of a Gaussian are neighbours.

use super::lists::{Order, TileEntries};
use crate::backend::gpu::{Gpu, arg};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Adds up each Gaussian's rows: one unit a Gaussian and column.
#[cube(launch)]
fn sum_rows(
    ids: &[u32],
    offsets: &[u32],
    ends: &[u32],
    rows: &[f32],
    moment_sums: &mut [f32],
    d_colours: &mut [f32],
    d_features: &mut [f32],
    gaussians: u32,
    channels: u32,
    first_channel: u32,
    first_entry: u32,
    end_entry: u32,
    #[comptime] block: usize,
    #[comptime] moments: usize,
    #[comptime] with_colours: bool,
    #[comptime] add_moments: bool,
    #[comptime] add_values: bool,
) {
    let columns = comptime![moments + block];
    let rank = ABSOLUTE_POS / columns;
    let column = ABSOLUTE_POS % columns;
    if rank >= gaussians as usize {
        terminate!();
    }
    let id = ids[rank] as usize;
    let first = max(offsets[rank], first_entry);
    let end = min(ends[rank], end_entry);
    let mut sum = 0.0f32;
    let mut entry = first;
    // Eight reads in flight at a time: a Gaussian may have thousands of rows.
    while entry + 8u32 <= end {
        let at = (entry - first_entry) as usize * columns + column;
        let mut part = 0.0f32;
        #[unroll]
        for k in 0..8usize {
            part += rows[at + k * columns];
        }
        sum += part;
        entry += 8u32;
    }
    while entry < end {
        sum += rows[(entry - first_entry) as usize * columns + column];
        entry += 1u32;
    }
    if column < moments {
        let to = id * moments + column;
        if comptime![add_moments] {
            sum += moment_sums[to];
        }
        moment_sums[to] = sum;
    } else {
        let channel = first_channel + (column - moments) as u32;
        if channel < channels {
            let mut colours_before = 0u32;
            if comptime![with_colours] {
                colours_before = 3u32;
            }
            if channel < colours_before {
                let to = 3 * id + channel as usize;
                if comptime![add_values] {
                    sum += d_colours[to];
                }
                d_colours[to] = sum;
            } else {
                let to =
                    id * (channels - colours_before) as usize + (channel - colours_before) as usize;
                if comptime![add_values] {
                    sum += d_features[to];
                }
                d_features[to] = sum;
            }
        }
    }
}

/// Sums over all pixels, a row for every Gaussian of the scene; zero for culled ones.
pub(super) struct PixelSums {
    /// `[N, 6]`, or `[N, 8]` with sums of absolute values; of any length where none are wanted.
    pub moments: CubeTensor,
    /// `[N, 3]`; of any length without colours.
    pub d_colours: CubeTensor,
    /// `[N, C]`; of any length without features.
    pub d_features: CubeTensor,
}

/// What one pass over the tiles covers: a block of channels and a range of entries.
pub(super) struct Slab {
    /// Of all blocks.
    pub channels: usize,
    pub first_channel: usize,
    pub block: usize,
    /// Moments of a row, before the block: all of them or none.
    pub moments: usize,
    pub with_colours: bool,
    pub first_entry: usize,
    pub end_entry: usize,
}

/// Adds `rows`, `[entries of the slab, moments + block]`, to `sums`; the first slab of each part overwrites it.
pub(super) fn add_rows(
    gpu: &Gpu,
    order: &Order,
    entries: &TileEntries,
    rows: &CubeTensor,
    slab: &Slab,
    sums: &PixelSums,
) {
    sum_rows::launch(
        &gpu.client,
        gpu.cubes_for(order.len * (slab.moments + slab.block)),
        gpu.dim(),
        arg(&order.ids),
        arg(&order.offsets),
        arg(&entries.ends),
        arg(rows),
        arg(&sums.moments),
        arg(&sums.d_colours),
        arg(&sums.d_features),
        order.len as u32,
        slab.channels as u32,
        slab.first_channel as u32,
        slab.first_entry as u32,
        slab.end_entry as u32,
        slab.block,
        slab.moments,
        slab.with_colours,
        slab.first_channel > 0 || slab.first_entry > 0,
        slab.first_entry > 0,
    );
}
