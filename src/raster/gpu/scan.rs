//! Prefix sums.

use crate::backend::gpu::{Gpu, UNITS, launch};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Consecutive values of a unit.
const ITEMS: usize = 8;
/// Values of a cube.
const BLOCK: usize = UNITS as usize * ITEMS;
/// Sums are capped here, so that none wraps: a total of [`CEILING`] means this or more.
pub(super) const CEILING: u32 = 0x7fff_ffff;
const GROUP: usize = 16;

#[cube]
fn capped(a: u32, b: u32) -> u32 {
    min(a + b, CEILING)
}

/// Replaces the [`UNITS`] values in `sums` by the capped sums of those before each. All units of the cube call it; `sums` is
/// complete before and after. `totals` holds [`GROUP`] + 1 values, the last of them the sum of all.
#[cube]
pub(super) fn scan_cube(sums: &mut Shared<[u32]>, totals: &mut Shared<[u32]>) {
    // Two levels of 16 serial sums: a third of the barriers of a doubling scan.
    let unit = UNIT_POS as usize;
    if unit < GROUP {
        let mut sum = 0u32;
        for k in 0..GROUP {
            let value = sums[unit * GROUP + k];
            sums[unit * GROUP + k] = sum;
            sum = capped(sum, value);
        }
        totals[unit] = sum;
    }
    sync_cube();
    if unit == 0 {
        let mut sum = 0u32;
        for k in 0..GROUP {
            let value = totals[k];
            totals[k] = sum;
            sum = capped(sum, value);
        }
        totals[GROUP] = sum;
    }
    sync_cube();
    sums[unit] = capped(sums[unit], totals[unit / GROUP]);
    sync_cube();
}

/// Exclusive sums within each block of [`BLOCK`] values, and the blocks' totals.
#[cube(launch)]
fn scan_blocks(values: &[u32], sums: &mut [u32], totals: &mut [u32], count: u32, blocks: u32) {
    if CUBE_POS >= blocks as usize {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let first = CUBE_POS * BLOCK + unit * ITEMS;
    let mut before = Array::<u32>::new(ITEMS);
    let mut sum = 0u32;
    #[unroll]
    for k in 0..ITEMS {
        before[k] = sum;
        if first + k < count as usize {
            sum = capped(sum, values[first + k]);
        }
    }
    let mut shared = Shared::<[u32]>::new_slice(UNITS as usize);
    let mut groups = Shared::<[u32]>::new_slice(GROUP + 1);
    shared[unit] = sum;
    sync_cube();
    scan_cube(&mut shared, &mut groups);
    #[unroll]
    for k in 0..ITEMS {
        if first + k < count as usize {
            sums[first + k] = capped(shared[unit], before[k]);
        }
    }
    if unit == 0 {
        totals[CUBE_POS] = groups[GROUP];
    }
}

/// Adds to every value what its block starts from.
#[cube(launch)]
fn add_block_starts(sums: &mut [u32], starts: &[u32], count: u32) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        sums[i] = capped(sums[i], starts[i / BLOCK]);
    }
}

/// The sum of the values before each of `values`, `len` of them, capped at [`CEILING`].
pub(super) fn exclusive_sums(gpu: &Gpu, values: &CubeTensor, len: usize) -> CubeTensor {
    let sums = gpu.words(len);
    if len == 0 {
        return sums;
    }
    let blocks = len.div_ceil(BLOCK);
    let totals = gpu.words(blocks);
    launch!(gpu, scan_blocks, gpu.cubes(blocks);
        values, &sums, &totals; len as u32, blocks as u32);
    if blocks == 1 {
        return sums;
    }
    let starts = exclusive_sums(gpu, &totals, blocks);
    launch!(gpu, add_block_starts, gpu.cubes_for(len);
        &sums, &starts; len as u32);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::gpu::fixture::{gpu, words};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn sums_of_what_comes_before() {
        let Some(gpu) = gpu() else { return };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for len in [
            1,
            7,
            8,
            255,
            2047,
            2048,
            2049,
            16_384,
            16_385,
            70_000,
            2048 * 2048 + 5,
        ] {
            let values: Vec<u32> = (0..len).map(|_| rng.random_range(0..100)).collect();
            let sums = words(&gpu, &exclusive_sums(&gpu, &gpu.upload(&values), len));
            let mut sum = 0;
            for (i, value) in values.iter().enumerate() {
                assert_eq!(sums[i], sum, "{i} of {len}");
                sum += value;
            }
        }
        let large = vec![1_u32 << 29; 5000];
        let sums = words(&gpu, &exclusive_sums(&gpu, &gpu.upload(&large), 5000));
        assert_eq!(sums[..3], [0, 1 << 29, 1 << 30]);
        assert!(sums[4..].iter().all(|&s| s == CEILING));
    }
}
