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
    value_sums: &mut [f32],
    gaussians: u32,
    channels: u32,
    first_channel: u32,
    first_entry: u32,
    end_entry: u32,
    #[comptime] block: usize,
    #[comptime] moments: usize,
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
            let to = id * channels as usize + channel as usize;
            if comptime![add_values] {
                sum += value_sums[to];
            }
            value_sums[to] = sum;
        }
    }
}

/// Sums over all pixels, a row for every Gaussian of the scene; zero for culled ones.
pub(super) struct PixelSums {
    /// `[N, 6]`, or `[N, 8]` with sums of absolute values; of any length where none are wanted.
    pub moments: CubeTensor,
    /// Gradients of the values, `[N, C]`.
    pub values: CubeTensor,
}

/// What one pass over the tiles covers: a block of channels and a range of entries.
pub(super) struct Slab {
    /// Of all blocks.
    pub channels: usize,
    pub first_channel: usize,
    pub block: usize,
    /// Moments of a row, before the block: all of them or none.
    pub moments: usize,
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
        arg(&sums.values),
        order.len as u32,
        slab.channels as u32,
        slab.first_channel as u32,
        slab.first_entry as u32,
        slab.end_entry as u32,
        slab.block,
        slab.moments,
        slab.first_channel > 0 || slab.first_entry > 0,
        slab.first_entry > 0,
    );
}
