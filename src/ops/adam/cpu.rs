//! The Adam step on slices.

use super::{AdamStep, EPSILON, Updated};
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::backend::{HostBackend, Real, device_of, real_kernel};
use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;
use std::sync::Arc;

/// Scalars that one task updates.
const CHUNK: usize = 1 << 14;

impl AdamStep {
    /// The step on slices, in place. All slices have one length; `rates` is not empty.
    pub fn apply<E: Real>(&self, param: &mut [E], grad: &[E], m: &mut [E], v: &mut [E]) {
        let period = self.rates.len().max(1);
        let (c1, c2) = self.corrections();
        // Whole periods in a tile, so that every tile starts at column 0.
        let tile = period * 64_usize.div_ceil(period);
        let rates = self.rates.iter().cycle().take(tile);
        let constants = Constants {
            rates: rates.map(|rate| E::of(rate / c1)).collect(),
            root: E::of(1.0 / c2.sqrt()),
            betas: self.betas(),
        };
        let chunk = tile * CHUNK.div_ceil(tile);
        param
            .par_chunks_mut(chunk)
            .zip(grad.par_chunks(chunk))
            .zip(m.par_chunks_mut(chunk).zip(v.par_chunks_mut(chunk)))
            .for_each(|((p, g), (m, v))| update(&constants, p, g, m, v));
    }
}

struct Constants<E> {
    /// Rates of one tile, divided by the correction of the first moment.
    rates: Vec<E>,
    /// Reciprocal root of the correction of the second moment.
    root: E,
    /// What both moments keep.
    betas: [f64; 2],
}

wide_kernel! {
    fn update(c: &Constants<E>, p: &mut [E], g: &[E], m: &mut [E], v: &mut [E]) => update_body
}

#[inline(always)]
fn update_body<E: Real, const FMA: bool>(
    c: &Constants<E>,
    p: &mut [E],
    g: &[E],
    m: &mut [E],
    v: &mut [E],
) {
    let tile = c.rates.len();
    let [[beta1, rest1], [beta2, rest2]] = c.betas.map(|beta| [beta, 1.0 - beta].map(E::of));
    let epsilon = E::of(EPSILON);
    let tiles = p
        .chunks_mut(tile)
        .zip(g.chunks(tile))
        .zip(m.chunks_mut(tile).zip(v.chunks_mut(tile)));
    for ((p, g), (m, v)) in tiles {
        let n = p.len().min(g.len()).min(m.len()).min(v.len()).min(tile);
        let p = &mut p[..n];
        let g = &g[..n];
        let m = &mut m[..n];
        let v = &mut v[..n];
        let rates = &c.rates[..n];
        for i in 0..n {
            let first = multiply_add::<E, FMA>(beta1, m[i], rest1 * g[i]);
            let second = multiply_add::<E, FMA>(beta2, v[i], rest2 * (g[i] * g[i]));
            m[i] = first;
            v[i] = second;
            p[i] -= rates[i] * first / (second.sqrt() * c.root + epsilon);
        }
    }
}

/// The step by the kernel for CPUs, wherever the tensors live.
pub fn adam_step<B: HostBackend>(
    param: FloatTensor<B>,
    grad: FloatTensor<B>,
    first: FloatTensor<B>,
    second: FloatTensor<B>,
    step: Arc<AdamStep>,
) -> Updated<B> {
    let device = device_of::<B>(&param);
    let shape = param.shape();
    real_kernel!(param, E => {
        let mut p = B::values::<E>(param).into_vec();
        let mut m = B::values::<E>(first).into_vec();
        let mut v = B::values::<E>(second).into_vec();
        step.apply(&mut p, &B::values::<E>(grad), &mut m, &mut v);
        (B::tensor(p, &shape, &device), B::tensor(m, &shape, &device), B::tensor(v, &shape, &device))
    })
}
