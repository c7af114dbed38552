//! Attentive pooling as one differentiable operation: the softmax over neighbours is never stored.

use crate::backend::device::in_host_memory;
use crate::backend::{HostBackend, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::{Tensor, activation::softmax};
use rayon::prelude::*;

/// Points handled by one task.
const BLOCK: usize = 64;

/// y[r, c] = sum_k softmax_k(scores[r, k, c]) x[r, k, c]; `x` and `scores` are `[R, k, channels]`.
pub fn pool<E: Real>(x: &[E], scores: &[E], k: usize, channels: usize) -> Vec<E> {
    let (row, rows) = (k * channels, x.len() / (k * channels).max(1));
    let mut out = vec![E::zero(); rows * channels];
    if out.is_empty() {
        return out;
    }
    out.par_chunks_mut(BLOCK * channels)
        .enumerate()
        .for_each_init(Vec::new, |buffer, (block, out)| {
            for (i, out) in out.chunks_exact_mut(channels).enumerate() {
                let start = (block * BLOCK + i) * row;
                let sums = attention(&scores[start..][..row], k, channels, buffer);
                for (x, w) in x[start..][..row]
                    .chunks_exact(channels)
                    .zip(buffer.chunks_exact(channels))
                {
                    for ((o, &x), &w) in out.iter_mut().zip(x).zip(w) {
                        *o += w * x;
                    }
                }
                out.iter_mut().zip(&sums).for_each(|(o, &s)| *o /= s);
            }
        });
    out
}

/// Gradients of [`pool`] to `x` and `scores` for the output's gradient `g` (`[R, channels]`):
/// dx = p g and dscores = p g (x - y), with p the softmax.
pub fn pool_adjoint<E: Real>(
    x: &[E],
    scores: &[E],
    g: &[E],
    k: usize,
    channels: usize,
) -> (Vec<E>, Vec<E>) {
    let row = k * channels;
    let (mut dx, mut ds) = (vec![E::zero(); x.len()], vec![E::zero(); x.len()]);
    if dx.is_empty() {
        return (dx, ds);
    }
    let blocks = dx
        .par_chunks_mut(BLOCK * row)
        .zip(ds.par_chunks_mut(BLOCK * row))
        .enumerate();
    blocks.for_each_init(Vec::new, |buffer, (block, (dx, ds))| {
        let mut mean = vec![E::zero(); channels];
        for (i, (dx, ds)) in dx
            .chunks_exact_mut(row)
            .zip(ds.chunks_exact_mut(row))
            .enumerate()
        {
            let r = block * BLOCK + i;
            let (x, g) = (&x[r * row..][..row], &g[r * channels..][..channels]);
            let sums = attention(&scores[r * row..][..row], k, channels, buffer);
            mean.fill(E::zero());
            for j in 0..row {
                let c = j % channels;
                buffer[j] /= sums[c];
                mean[c] += buffer[j] * x[j];
            }
            for j in 0..row {
                let c = j % channels;
                dx[j] = buffer[j] * g[c];
                ds[j] = dx[j] * (x[j] - mean[c]);
            }
        }
    });
    (dx, ds)
}

/// Puts exp(score - max) per channel into `out` (`[k, channels]`) and returns its sums over k.
fn attention<E: Real>(scores: &[E], k: usize, channels: usize, out: &mut Vec<E>) -> Vec<E> {
    let mut highest = scores[..channels].to_vec();
    for s in scores.chunks_exact(channels).skip(1) {
        highest
            .iter_mut()
            .zip(s)
            .for_each(|(h, &s)| *h = if s > *h { s } else { *h });
    }
    let mut sums = vec![E::zero(); channels];
    out.resize(k * channels, E::zero());
    for (out, s) in out
        .chunks_exact_mut(channels)
        .zip(scores.chunks_exact(channels))
    {
        for c in 0..channels {
            out[c] = (s[c] - highest[c]).exp();
            sums[c] += out[c];
        }
    }
    sums
}

/// Backend side of [`attentive_pool`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait PoolBackend: Backend {
    /// What [`attentive_pool()`] gives; tensors are `[R k, channels]`.
    fn attentive_pool(
        x: FloatTensor<Self>,
        scores: FloatTensor<Self>,
        k: usize,
    ) -> FloatTensor<Self>;
    /// Gradients to `x` and `scores`.
    fn attentive_pool_adjoint(
        x: FloatTensor<Self>,
        scores: FloatTensor<Self>,
        g: FloatTensor<Self>,
        k: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostBackend> PoolBackend for B {
    fn attentive_pool(
        x: FloatTensor<Self>,
        scores: FloatTensor<Self>,
        k: usize,
    ) -> FloatTensor<Self> {
        let (device, [rows, channels]) = (device_of::<B>(&x), x.shape().dims());
        real_kernel!(x, E => {
            let y = pool::<E>(&B::values(x), &B::values(scores), k, channels);
            B::tensor::<E>(y, &[rows / k, channels], &device)
        })
    }

    fn attentive_pool_adjoint(
        x: FloatTensor<Self>,
        scores: FloatTensor<Self>,
        g: FloatTensor<Self>,
        k: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (device, [rows, channels]) = (device_of::<B>(&x), x.shape().dims());
        real_kernel!(x, E => {
            let (dx, ds) = pool_adjoint::<E>(&B::values(x), &B::values(scores), &B::values(g), k, channels);
            (B::tensor::<E>(dx, &[rows, channels], &device), B::tensor::<E>(ds, &[rows, channels], &device))
        })
    }
}

#[derive(Debug)]
struct PoolBackward;

impl<B: PoolBackend> Backward<B, 2> for PoolBackward {
    type State = (FloatTensor<B>, FloatTensor<B>, usize);

    fn backward(
        self,
        ops: Ops<Self::State, 2>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let (x, scores, k) = ops.state;
        let (dx, ds) = B::attentive_pool_adjoint(x, scores, g, k);
        let [x_node, score_node] = ops.parents;
        if let Some(node) = x_node {
            grads.register::<B>(node.id, dx);
        }
        if let Some(node) = score_node {
            grads.register::<B>(node.id, ds);
        }
    }
}

impl<B: PoolBackend, C: CheckpointStrategy> PoolBackend for Autodiff<B, C> {
    fn attentive_pool(
        x: FloatTensor<Self>,
        scores: FloatTensor<Self>,
        k: usize,
    ) -> FloatTensor<Self> {
        let (x, x_node) = x.into_parts();
        let (scores, score_node) = scores.into_parts();
        match PoolBackward
            .prepare::<C>([x_node, score_node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let out = B::attentive_pool(x.clone(), scores.clone(), k);
                prep.finish((x, scores, k), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::attentive_pool(x, scores, k)),
        }
    }

    fn attentive_pool_adjoint(
        _x: FloatTensor<Self>,
        _scores: FloatTensor<Self>,
        _g: FloatTensor<Self>,
        _k: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        unimplemented!("second-order gradients")
    }
}

/// Sum of the `k` rows of each point weighted by the softmax of their scores, per channel: `x` and `scores` are
/// `[R k, channels]`, the result `[R, channels]`. Gradients to both. On a GPU it is [`attentive_pool_plain`].
///
/// # Panics
/// If the shapes differ or the rows are no multiple of `k`.
pub fn attentive_pool(x: Tensor<2>, scores: Tensor<2>, k: usize) -> Tensor<2> {
    assert_eq!(
        x.dims(),
        scores.dims(),
        "attentive_pool: shapes of x and scores"
    );
    assert_eq!(
        x.dims()[0] % k,
        0,
        "attentive_pool: rows must be a multiple of {k}"
    );
    if !in_host_memory(&x.device()) {
        return attentive_pool_plain(x, scores, k);
    }
    Tensor::from_dispatch(Dispatch::attentive_pool(
        x.into_dispatch(),
        scores.into_dispatch(),
        k,
    ))
}

/// [`attentive_pool`] in plain tensors: what runs on a GPU, and the reference of its tests.
pub fn attentive_pool_plain(x: Tensor<2>, scores: Tensor<2>, k: usize) -> Tensor<2> {
    let [rows, channels] = x.dims();
    let shape = [rows / k, k, channels];
    let weights = softmax(scores.reshape(shape), 1);
    (x.reshape(shape) * weights)
        .sum_dim(1)
        .reshape([rows / k, channels])
}
