//! Stable radix sort of keys with a value each, least significant digit first.
//!
//! A digit has four bits, so that a cube can keep a counter for every digit and unit in shared memory: units count
//! their own consecutive keys, one scan ranks all of them, and no subgroup operation is needed.

use super::buffers::{Gpu, UNITS, arg};
use super::scan::{exclusive_sums, scan_cube};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

const BITS: u32 = 4;
const DIGITS: usize = 1 << BITS;
/// Counters are packed in pairs: digits `d` and `d + HALF`.
const HALF: usize = DIGITS / 2;
/// Consecutive keys of a unit.
const ITEMS: usize = 8;
/// Keys of a cube.
const BLOCK: usize = UNITS as usize * ITEMS;

/// `counts[digit * blocks + block]`: keys of the block with that digit.
#[cube(launch)]
fn count_digits(keys: &[u32], counts: &mut [u32], count: u32, blocks: u32, shift: u32) {
    if CUBE_POS >= blocks as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let bins = Shared::<[Atomic<u32>]>::new_slice(DIGITS);
    if unit < DIGITS {
        bins[unit].store(0u32);
    }
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        let i = CUBE_POS * BLOCK + k * UNITS as usize + unit;
        if i < count as usize {
            bins[((keys[i] >> shift) & 15u32) as usize].fetch_add(1u32);
        }
    }
    sync_cube();
    if unit < DIGITS {
        counts[unit * blocks as usize + CUBE_POS] = bins[unit].load();
    }
}

/// Moves every key to its place among all, `starts` being the exclusive sums of the counts.
#[cube(launch)]
fn scatter(
    keys: &[u32],
    values: &[u32],
    starts: &[u32],
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    count: u32,
    blocks: u32,
    shift: u32,
    #[comptime] values_are_positions: bool,
) {
    if CUBE_POS >= blocks as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let mut counters = Shared::<[u32]>::new_slice(HALF * UNITS as usize);
    let mut block_keys = Shared::<[u32]>::new_slice(BLOCK);
    let mut block_values = Shared::<[u32]>::new_slice(BLOCK);
    let mut sums = Shared::<[u32]>::new_slice(UNITS as usize);
    let mut totals = Shared::<[u32]>::new_slice(17usize);
    let mut digit_starts = Shared::<[u32]>::new_slice(DIGITS);
    let first = CUBE_POS * BLOCK + unit * ITEMS;

    let mut own_keys = Array::<u32>::new(ITEMS);
    let mut own_ranks = Array::<u32>::new(ITEMS);
    #[unroll]
    for d in 0..HALF {
        counters[d * UNITS as usize + unit] = 0u32;
    }
    #[unroll]
    for k in 0..ITEMS {
        // Past the end the largest key: it comes after all real ones of its digit.
        let mut key = 0xffff_ffffu32;
        if first + k < count as usize {
            key = keys[first + k];
        }
        let digit = (key >> shift) & 15u32;
        let half = (digit / 8u32) * 16u32;
        let at = (digit % 8u32) as usize * UNITS as usize + unit;
        let counter = counters[at];
        own_keys[k] = key;
        own_ranks[k] = (counter >> half) & 0xffffu32;
        counters[at] = counter + (1u32 << half);
    }
    sync_cube();

    let mut sum = 0u32;
    #[unroll]
    for k in 0..HALF {
        let value = counters[unit * HALF + k];
        counters[unit * HALF + k] = sum;
        sum += value;
    }
    sums[unit] = sum;
    sync_cube();
    scan_cube(&mut sums, &mut totals);
    let before = sums[unit];
    #[unroll]
    for k in 0..HALF {
        counters[unit * HALF + k] += before;
    }
    sync_cube();

    // Digits of the upper half come after all of the lower half.
    let lower = totals[16] & 0xffffu32;
    #[unroll]
    for k in 0..ITEMS {
        let key = own_keys[k];
        let digit = (key >> shift) & 15u32;
        let half = digit / 8u32;
        let at = (digit % 8u32) as usize * UNITS as usize + unit;
        let place = ((counters[at] >> (half * 16u32)) & 0xffffu32) + half * lower + own_ranks[k];
        block_keys[place as usize] = key;
        if comptime![values_are_positions] {
            block_values[place as usize] = (first + k) as u32;
        } else if first + k < count as usize {
            block_values[place as usize] = values[first + k];
        }
    }
    if unit < DIGITS {
        let half = unit as u32 / 8u32;
        let local = ((counters[(unit % 8) * UNITS as usize] >> (half * 16u32)) & 0xffffu32) + half * lower;
        // Wraps where the block's part starts before the digit's place; adding the place within the block undoes that.
        digit_starts[unit] = starts[unit * blocks as usize + CUBE_POS] - local;
    }
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        let place = k * UNITS as usize + unit;
        if CUBE_POS * BLOCK + place < count as usize {
            let key = block_keys[place];
            let to = (digit_starts[((key >> shift) & 15u32) as usize] + place as u32) as usize;
            sorted_keys[to] = key;
            sorted_values[to] = block_values[place];
        }
    }
}

/// Keys in ascending order by their lowest `bits` bits, and the position that each of them had; equal keys keep their
/// order.
pub(super) fn sort_positions(gpu: &Gpu, keys: CubeTensor, len: usize, bits: u32) -> (CubeTensor, CubeTensor) {
    let blocks = len.div_ceil(BLOCK);
    let mut keys = keys;
    let mut values = gpu.words(len);
    if len == 0 {
        return (keys, values);
    }
    for pass in 0..bits.div_ceil(BITS).max(1) {
        let shift = pass * BITS;
        let counts = gpu.words(DIGITS * blocks);
        count_digits::launch(
            &gpu.client,
            gpu.cubes(blocks),
            gpu.dim(),
            arg(&keys),
            arg(&counts),
            len as u32,
            blocks as u32,
            shift,
        );
        let starts = exclusive_sums(gpu, &counts, DIGITS * blocks);
        let (sorted_keys, sorted_values) = (gpu.words(len), gpu.words(len));
        scatter::launch(
            &gpu.client,
            gpu.cubes(blocks),
            gpu.dim(),
            arg(&keys),
            arg(&values),
            arg(&starts),
            arg(&sorted_keys),
            arg(&sorted_values),
            len as u32,
            blocks as u32,
            shift,
            pass == 0,
        );
        (keys, values) = (sorted_keys, sorted_values);
    }
    (keys, values)
}
