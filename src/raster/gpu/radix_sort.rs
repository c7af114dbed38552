//! Stable radix sort of keys with a value each, least significant digit first.
//!
//! A digit has eight bits. Within its block a cube sorts by them four at a time. Then shared memory has room for a counter of every
//! unit and half digit. Units count their own consecutive keys, one scan ranks all keys, and no subgroup operation is needed. Then
//! every key goes to its position among all, neighbours together.

use super::scan::{exclusive_sums, scan_cube};
use crate::backend::gpu::{Gpu, UNITS, launch};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Bits of a digit.
const BITS: u32 = 8;
const DIGITS: usize = 1 << BITS;
/// Bits that a block is sorted by at a time.
const HALF_BITS: u32 = BITS / 2;
/// Counters are packed in pairs: half digits `d` and `d + PAIRED`.
const PAIRED: usize = 1 << (HALF_BITS - 1);
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
    // There are as many units as digits.
    let unit = UNIT_POS as usize;
    let bins = Shared::<[Atomic<u32>]>::new_slice(DIGITS);
    bins[unit].store(0u32);
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        let i = CUBE_POS * BLOCK + k * UNITS as usize + unit;
        if i < count as usize {
            bins[((keys[i] >> shift) & 255u32) as usize].fetch_add(1u32);
        }
    }
    sync_cube();
    counts[unit * blocks as usize + CUBE_POS] = bins[unit].load();
}

/// Shared memory of [`rank`].
#[derive(CubeType)]
struct Counters {
    /// `[PAIRED, UNITS]`.
    pairs: Shared<[u32]>,
    sums: Shared<[u32]>,
    totals: Shared<[u32]>,
}

/// Positions of the unit's keys when the block is sorted by the four bits from `shift` on.
#[cube]
fn rank(keys: &Array<u32>, shift: u32, counters: &mut Counters) -> Array<u32> {
    let unit = UNIT_POS as usize;
    let mut places = Array::<u32>::new(ITEMS);
    #[unroll]
    for d in 0..PAIRED {
        counters.pairs[d * UNITS as usize + unit] = 0u32;
    }
    #[unroll]
    for k in 0..ITEMS {
        let digit = (keys[k] >> shift) & 15u32;
        let half = (digit / 8u32) * 16u32;
        let at = (digit % 8u32) as usize * UNITS as usize + unit;
        let counter = counters.pairs[at];
        places[k] = (counter >> half) & 0xffffu32;
        counters.pairs[at] = counter + (1u32 << half);
    }
    sync_cube();
    let mut sum = 0u32;
    #[unroll]
    for k in 0..PAIRED {
        let value = counters.pairs[unit * PAIRED + k];
        counters.pairs[unit * PAIRED + k] = sum;
        sum += value;
    }
    counters.sums[unit] = sum;
    sync_cube();
    scan_cube(&mut counters.sums, &mut counters.totals);
    let before = counters.sums[unit];
    #[unroll]
    for k in 0..PAIRED {
        counters.pairs[unit * PAIRED + k] += before;
    }
    sync_cube();
    // Half digits of the upper half come after all of the lower one.
    let lower = counters.totals[16] & 0xffffu32;
    #[unroll]
    for k in 0..ITEMS {
        let digit = (keys[k] >> shift) & 15u32;
        let half = digit / 8u32;
        let at = (digit % 8u32) as usize * UNITS as usize + unit;
        places[k] += ((counters.pairs[at] >> (half * 16u32)) & 0xffffu32) + half * lower;
    }
    places
}

/// Moves every key to its position among all, `starts` being the exclusive sums of the counts.
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
    let mut block_keys = Shared::<[u32]>::new_slice(BLOCK);
    let mut block_values = Shared::<[u32]>::new_slice(BLOCK);
    let mut digit_starts = Shared::<[u32]>::new_slice(DIGITS);
    let mut counters = Counters {
        pairs: Shared::<[u32]>::new_slice(PAIRED * UNITS as usize),
        sums: Shared::<[u32]>::new_slice(UNITS as usize),
        totals: Shared::<[u32]>::new_slice(17usize),
    };
    let first = CUBE_POS * BLOCK + unit * ITEMS;
    let mut own_keys = Array::<u32>::new(ITEMS);
    let mut own_values = Array::<u32>::new(ITEMS);
    #[unroll]
    for k in 0..ITEMS {
        // Past the end the largest key: it comes after all real ones.
        own_keys[k] = 0xffff_ffffu32;
        own_values[k] = 0u32;
        if first + k < count as usize {
            own_keys[k] = keys[first + k];
            if comptime![values_are_positions] {
                own_values[k] = (first + k) as u32;
            } else {
                own_values[k] = values[first + k];
            }
        }
    }
    let places = rank(&own_keys, shift, &mut counters);
    #[unroll]
    for k in 0..ITEMS {
        block_keys[places[k] as usize] = own_keys[k];
        block_values[places[k] as usize] = own_values[k];
    }
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        own_keys[k] = block_keys[unit * ITEMS + k];
        own_values[k] = block_values[unit * ITEMS + k];
    }
    let places = rank(&own_keys, shift + HALF_BITS, &mut counters);
    #[unroll]
    for k in 0..ITEMS {
        block_keys[places[k] as usize] = own_keys[k];
        block_values[places[k] as usize] = own_values[k];
    }
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        let place = k * UNITS as usize + unit;
        let digit = (block_keys[place] >> shift) & 255u32;
        let mut before = 0xffff_ffffu32;
        if place > 0 {
            before = (block_keys[place - 1] >> shift) & 255u32;
        }
        if before != digit {
            // Wraps where the digit starts later in the block than among all; adding a position in the block undoes that.
            digit_starts[digit as usize] =
                starts[digit as usize * blocks as usize + CUBE_POS] - place as u32;
        }
    }
    sync_cube();
    #[unroll]
    for k in 0..ITEMS {
        let place = k * UNITS as usize + unit;
        if CUBE_POS * BLOCK + place < count as usize {
            let key = block_keys[place];
            let to = (digit_starts[((key >> shift) & 255u32) as usize] + place as u32) as usize;
            sorted_keys[to] = key;
            sorted_values[to] = block_values[place];
        }
    }
}

/// Keys in ascending order by their lowest `bits` bits, and the position that each of them had; equal keys keep their
/// order.
pub(super) fn sort_positions(
    gpu: &Gpu,
    keys: CubeTensor,
    len: usize,
    bits: u32,
) -> (CubeTensor, CubeTensor) {
    let blocks = len.div_ceil(BLOCK);
    let mut keys = keys;
    let mut values = gpu.words(len);
    if len == 0 {
        return (keys, values);
    }
    for pass in 0..bits.div_ceil(BITS).max(1) {
        let shift = pass * BITS;
        let counts = gpu.words(DIGITS * blocks);
        launch!(gpu, count_digits, gpu.cubes(blocks);
            &keys, &counts; len as u32, blocks as u32, shift);
        let starts = exclusive_sums(gpu, &counts, DIGITS * blocks);
        let sorted_keys = gpu.words(len);
        let sorted_values = gpu.words(len);
        launch!(gpu, scatter, gpu.cubes(blocks);
            &keys, &values, &starts, &sorted_keys, &sorted_values;
            len as u32, blocks as u32, shift, pass == 0);
        (keys, values) = (sorted_keys, sorted_values);
    }
    (keys, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::gpu::fixture::{gpu, words};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn sorting_is_stable() {
        let Some(gpu) = gpu() else { return };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (len, bits) in [
            (1, 32),
            (5, 4),
            (255, 10),
            (2048, 32),
            (2049, 13),
            (50_000, 13),
            (50_000, 32),
            (300_000, 8),
        ] {
            let most = u32::MAX >> (32 - bits);
            let keys: Vec<u32> = (0..len).map(|_| rng.random_range(0..=most)).collect();
            let (sorted, positions) = sort_positions(&gpu, gpu.upload(&keys), len, bits);
            let mut want: Vec<u32> = (0..len as u32).collect();
            want.sort_by_key(|&i| keys[i as usize]);
            assert!(
                words(&gpu, &positions)[..len] == want,
                "positions of {len} keys of {bits} bits"
            );
            let want: Vec<u32> = want.iter().map(|&i| keys[i as usize]).collect();
            assert!(
                words(&gpu, &sorted)[..len] == want,
                "{len} keys of {bits} bits"
            );
        }
    }
}
