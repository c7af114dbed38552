//! What a device can do at most: kernels that copy, multiply and add, or do next to nothing.

use super::device::ProbeBackend;
use crate::backend::gpu::{Gpu, arg};
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;

/// Floats that a unit copies together.
const VECTOR: usize = 4;
/// Chains of a unit; other units of the same core hide what latency is left.
pub(super) const CHAINS: usize = 8;
/// Steps between two looks at the counter.
pub(super) const STEPS: usize = 16;

#[cube(launch)]
fn copy<N: Size>(from: &[Vector<f32, N>], to: &mut [Vector<f32, N>], count: u32) {
    if ABSOLUTE_POS < count as usize {
        to[ABSOLUTE_POS] = from[ABSOLUTE_POS];
    }
}

/// Sums of each unit's chains, which start at its value and 1, 2, ... above.
#[cube(launch)]
fn chains(starts: &[f32], sums: &mut [f32], count: u32, rounds: u32, factor: f32, term: f32) {
    if ABSOLUTE_POS >= count as usize {
        terminate!();
    }
    let mut x = Array::<f32>::new(CHAINS);
    #[unroll]
    for k in 0..CHAINS {
        x[k] = starts[ABSOLUTE_POS] + f32::cast_from(k);
    }
    for _ in 0..rounds {
        #[unroll]
        for _ in 0..STEPS {
            #[unroll]
            for k in 0..CHAINS {
                x[k] = fma(x[k], factor, term);
            }
        }
    }
    let mut sum = 0.0f32;
    #[unroll]
    for k in 0..CHAINS {
        sum += x[k];
    }
    sums[ABSOLUTE_POS] = sum;
}

#[cube(launch)]
fn count_up(cell: &mut [f32]) {
    if ABSOLUTE_POS == 0 {
        cell[0] += 1.0f32;
    }
}

impl ProbeBackend for CubeBackend {
    fn probe_copy(
        from: FloatTensor<Self>,
        to: FloatTensor<Self>,
        passes: usize,
    ) -> FloatTensor<Self> {
        let (gpu, from) = (Gpu::of(&from), into_contiguous(from));
        let vectors = from.meta.num_elements() / VECTOR;
        for _ in 0..passes {
            let cubes = gpu.cubes_for(vectors);
            copy::launch(
                &gpu.client,
                cubes,
                gpu.dim(),
                VECTOR,
                arg(&from),
                arg(&to),
                vectors as u32,
            );
        }
        to
    }

    fn probe_chains(
        starts: FloatTensor<Self>,
        factor: f32,
        term: f32,
        rounds: usize,
    ) -> FloatTensor<Self> {
        let (gpu, starts) = (Gpu::of(&starts), into_contiguous(starts));
        let count = starts.meta.num_elements();
        let sums = gpu.floats([count]);
        let rounds = rounds as u32;
        let cubes = gpu.cubes_for(count);
        chains::launch(
            &gpu.client,
            cubes,
            gpu.dim(),
            arg(&starts),
            arg(&sums),
            count as u32,
            rounds,
            factor,
            term,
        );
        sums
    }

    fn probe_launches(cell: FloatTensor<Self>, launches: usize) -> FloatTensor<Self> {
        let gpu = Gpu::of(&cell);
        for _ in 0..launches {
            count_up::launch(&gpu.client, gpu.cubes_for(1), gpu.dim(), arg(&cell));
        }
        cell
    }
}
