//! Eq. 9 on a device, value and gradient: no softmax is stored, and what meets at a row is summed there, in order.

use super::covers;
use crate::backend::gpu::{Gpu, UNITS, arg, sum, sum_cube};
use crate::ops::neighbour_divergence::{DivergenceBackend, NeighbourPairs, on_host};
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use std::sync::Arc;

/// Sizes of the pairs: rows of the features, samples M, neighbours K of each.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
struct Sizes {
    rows: u32,
    samples: u32,
    neighbours: u32,
    width: u32,
}

/// ln sum exp of each row, one unit a row.
#[cube(launch)]
fn log_sums(features: &[f32], shifts: &mut [f32], rows: u32, width: u32) {
    let row = ABSOLUTE_POS;
    if row >= rows as usize {
        terminate!();
    }
    let first = row * width as usize;
    let mut highest = features[first];
    for c in 0..width as usize {
        highest = max(highest, features[first + c]);
    }
    let mut total = 0.0f32;
    for c in 0..width as usize {
        total += (features[first + c] - highest).exp();
    }
    shifts[row] = highest + total.ln();
}

/// Sum over the neighbours of a sample of ln p_j / p_k in one channel; `log_p` is ln p_j.
#[cube]
fn ratio(
    features: &[f32],
    shifts: &[f32],
    pairs: &[u32],
    sample: usize,
    log_p: f32,
    channel: usize,
    sizes: &Sizes,
) -> f32 {
    let first = sizes.samples as usize + sample * sizes.neighbours as usize;
    let mut sum = 0.0f32;
    for k in 0..sizes.neighbours as usize {
        let other = pairs[first + k] as usize;
        sum += log_p - (features[other * sizes.width as usize + channel] - shifts[other]);
    }
    sum
}

/// Times `scale`, the divergences of each sample from its neighbours, one cube a sample.
#[cube(launch)]
fn divergences(
    features: &[f32],
    shifts: &[f32],
    pairs: &[u32],
    values: &mut [f32],
    sizes: Sizes,
    scale: f32,
) {
    let sample = CUBE_POS;
    if sample >= sizes.samples as usize {
        terminate!();
    }
    let row = pairs[sample] as usize;
    let mut sum = 0.0f32;
    let mut c = UNIT_POS as usize;
    while c < sizes.width as usize {
        let log_p = features[row * sizes.width as usize + c] - shifts[row];
        sum += log_p.exp() * ratio(features, shifts, pairs, sample, log_p, c, &sizes);
        c += UNITS as usize;
    }
    let all = sum_cube(sum);
    if UNIT_POS == 0 {
        values[sample] = all * scale;
    }
}

/// The gradient, one unit a value: what a row gets as a neighbour, `p_k - p_j` from each sample j, and as a sample,
/// `p_j (sum of ln p_j / p_k - divergence)`.
#[cube(launch)]
fn divergence_gradient(
    features: &[f32],
    shifts: &[f32],
    pairs: &[u32],
    values: &[f32],
    gradient: &mut [f32],
    sizes: Sizes,
    scale: f32,
    count: f32,
) {
    let width = sizes.width as usize;
    let row = ABSOLUTE_POS / width;
    let c = ABSOLUTE_POS % width;
    if row >= sizes.rows as usize {
        terminate!();
    }
    let listed = (sizes.samples * sizes.neighbours) as usize;
    let offsets = sizes.samples as usize + listed;
    let members = offsets + sizes.rows as usize + 1;
    let samples = members + listed;
    let log_p = features[ABSOLUTE_POS] - shifts[row];
    let p = log_p.exp();
    let mut g = 0.0f32;
    for at in pairs[offsets + row]..pairs[offsets + row + 1] {
        let from = pairs[members + at as usize] as usize;
        g += p - (features[from * width + c] - shifts[from]).exp();
    }
    let sample = pairs[samples + row];
    if sample > 0u32 {
        let sample = (sample - 1u32) as usize;
        g +=
            p * (ratio(features, shifts, pairs, sample, log_p, c, &sizes) - values[sample] * count);
    }
    gradient[ABSOLUTE_POS] = g * scale;
}

/// For the kernels, one after the other: the M sampled rows; their neighbours, `[M, K]`; where the list of each of `rows` rows
/// begins, and where the last ends; these lists: the samples that a row is a neighbour of; for each row the number of its
/// sample, from 1, or 0. Nothing where a row was sampled twice.
fn tables(pairs: &NeighbourPairs, rows: usize) -> Option<Vec<u32>> {
    let k = pairs.neighbours.len() / pairs.chosen.len();
    let mut offsets = vec![0_u32; rows + 1];
    pairs
        .neighbours
        .iter()
        .for_each(|&row| offsets[row as usize + 1] += 1);
    for row in 0..rows {
        offsets[row + 1] += offsets[row];
    }
    let (mut next, mut members) = (offsets.clone(), vec![0; pairs.neighbours.len()]);
    let mut samples = vec![0; rows];
    for ((&chosen, neighbours), number) in pairs
        .chosen
        .iter()
        .zip(pairs.neighbours.chunks_exact(k))
        .zip(1..)
    {
        if std::mem::replace(&mut samples[chosen as usize], number) != 0 {
            return None;
        }
        for &row in neighbours {
            let place = &mut next[row as usize];
            members[*place as usize] = chosen;
            *place += 1;
        }
    }
    Some(
        [
            &pairs.chosen,
            &pairs.neighbours,
            &offsets,
            &members,
            &samples,
        ]
        .map(|part| &part[..])
        .concat(),
    )
}

impl DivergenceBackend for CubeBackend {
    fn neighbour_divergence(
        features: FloatTensor<Self>,
        pairs: Arc<NeighbourPairs>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let [rows, width] = features.meta.shape().dims();
        let usable = covers(&features) && width > 0 && !pairs.neighbours.is_empty();
        let Some(tables) = usable.then(|| tables(&pairs, rows)).flatten() else {
            return on_host::neighbour_divergence::<Self>(features, &pairs);
        };
        let gpu = Gpu::of(&features);
        let features = into_contiguous(features);
        let (samples, listed) = (pairs.chosen.len(), pairs.neighbours.len());
        let tables = gpu.upload(&tables, DType::U32);
        let (shifts, values, gradient) = (
            gpu.floats([rows]),
            gpu.floats([samples]),
            gpu.floats([rows, width]),
        );
        let sizes = || {
            SizesLaunch::new(
                rows as u32,
                samples as u32,
                (listed / samples) as u32,
                width as u32,
            )
        };
        let scale = (1.0 / listed as f64) as f32;
        let dim = gpu.dim();
        log_sums::launch(
            &gpu.client,
            gpu.cubes_for(rows),
            dim,
            arg(&features),
            arg(&shifts),
            rows as u32,
            width as u32,
        );
        divergences::launch(
            &gpu.client,
            gpu.cubes(samples),
            dim,
            arg(&features),
            arg(&shifts),
            arg(&tables),
            arg(&values),
            sizes(),
            scale,
        );
        divergence_gradient::launch(
            &gpu.client,
            gpu.cubes_for(rows * width),
            dim,
            arg(&features),
            arg(&shifts),
            arg(&tables),
            arg(&values),
            arg(&gradient),
            sizes(),
            scale,
            listed as f32,
        );
        (sum(&gpu, &values, samples), gradient)
    }
}
