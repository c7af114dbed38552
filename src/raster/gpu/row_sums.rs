//! Sums over the tiles of each Gaussian. Each tile entry has a row; the rows of a Gaussian are neighbours.

use burn_cubecl::cubecl::{self, prelude::*};

/// Adds up each Gaussian's rows: one unit for each Gaussian and column.
#[cube(launch)]
pub(super) fn sum_rows(
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
