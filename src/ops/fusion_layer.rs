//! One layer of the decoder (Eq. 7) as a fused operation: `leaky(x[rows] W + US y + b)`.
//!
//! In plain tensors a layer makes eight arrays as tall as the scene, forward and backward, and most of a step goes into
//! touching them. Here rows are gathered, mapped, summed and bent a block at a time, while they are in the cache.

use super::RowList;
use super::sparse::{SparseMatrix, sparse_apply};
use crate::backend::matmul::{add_product, add_product_of_transposed, product_with_transposed};
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension,
    tensor::FloatTensor,
};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Int, Tensor, TensorData};
use rayon::prelude::*;
use std::sync::Arc;

/// Rows that go through a layer together.
const BLOCK: usize = 128;
/// Rows whose share of the weights' gradient is summed before it is added to the others', in order.
const PART: usize = 16 * BLOCK;

/// The constant part of a layer.
#[derive(Clone, Debug)]
pub struct LayerMap {
    /// Rows of `x` that the layer reads, `[R]`, each below the rows of `x` and none twice; absent: all of them.
    pub rows: Option<Arc<RowList>>,
    /// `US`, `[R, M]`.
    pub upsample: Arc<SparseMatrix>,
    /// Slope of the leaky ReLU below zero, above 0; 1 leaves the sum as it is.
    pub slope: f64,
}

impl LayerMap {
    fn row(&self, r: usize) -> usize {
        self.rows.as_ref().map_or(r, |rows| rows[r] as usize)
    }

    /// Rows `first..first + count` of `x` (`[.., width]`), in `buffer` where they are not consecutive.
    fn gather<'a, E: Real>(
        &self,
        x: &'a [E],
        width: usize,
        first: usize,
        count: usize,
        buffer: &'a mut Vec<E>,
    ) -> &'a [E] {
        let Some(rows) = &self.rows else {
            return &x[first * width..][..count * width];
        };
        buffer.clear();
        for &row in &rows[first..first + count] {
            buffer.extend_from_slice(&x[row as usize * width..][..width]);
        }
        buffer
    }

    /// The layer: `x` is `[.., K]`, `weight` `[K, D]`, `below` `[M, D]`, `bias` `[D]`; the result `[R, D]`.
    pub fn apply<E: Real>(&self, x: &[E], weight: &[E], below: &[E], bias: &[E]) -> Vec<E> {
        let (width, slope) = (bias.len(), E::of(self.slope));
        let inputs = weight.len() / width.max(1);
        let mut out = vec![E::zero(); self.upsample.rows() * width];
        if out.is_empty() {
            return out;
        }
        out.par_chunks_mut(BLOCK * width).enumerate().for_each_init(
            Vec::new,
            |buffer, (block, out)| {
                let (first, count) = (block * BLOCK, out.len() / width);
                out.chunks_exact_mut(width)
                    .for_each(|row| row.copy_from_slice(bias));
                self.upsample.add_rows(first, below, width, out);
                add_product(
                    self.gather(x, inputs, first, count, buffer),
                    inputs,
                    weight,
                    width,
                    out,
                );
                out.iter_mut()
                    .for_each(|v| *v = if *v > E::zero() { *v } else { slope * *v });
            },
        );
        out
    }

    /// Gradients for the gradient `g` (`[R, D]`) of the output `out`. That of `x` (`[rows_of_x, K]`) only where
    /// `rows_of_x` is given.
    pub fn adjoint<E: Real>(
        &self,
        x: &[E],
        weight: &[E],
        out: &[E],
        mut g: Vec<E>,
        width: usize,
        rows_of_x: Option<usize>,
    ) -> LayerGradients<E> {
        let (inputs, slope) = (weight.len() / width.max(1), E::of(self.slope));
        let (mut d_weight, mut d_bias) = (vec![E::zero(); weight.len()], vec![E::zero(); width]);
        let parts: Vec<_> = g
            .par_chunks_mut((PART * width).max(1))
            .zip(out.par_chunks((PART * width).max(1)))
            .enumerate()
            .map_init(Vec::new, |buffer, (part, (g, out))| {
                g.iter_mut()
                    .zip(out)
                    .for_each(|(g, &out)| *g = if out > E::zero() { *g } else { slope * *g });
                let (mut d_weight, mut d_bias) =
                    (vec![E::zero(); weight.len()], vec![E::zero(); width]);
                for (block, g) in g.chunks(BLOCK * width).enumerate() {
                    let (first, count) = (part * PART + block * BLOCK, g.len() / width);
                    let x = self.gather(x, inputs, first, count, buffer);
                    add_product_of_transposed(x, inputs, g, width, &mut d_weight);
                    for g in g.chunks_exact(width) {
                        d_bias.iter_mut().zip(g).for_each(|(d, &g)| *d += g);
                    }
                }
                (d_weight, d_bias)
            })
            .collect();
        for (weight, bias) in parts {
            d_weight.iter_mut().zip(weight).for_each(|(d, v)| *d += v);
            d_bias.iter_mut().zip(bias).for_each(|(d, v)| *d += v);
        }
        let d_x = rows_of_x.map(|rows| {
            let mut product = vec![E::zero(); g.len() / width.max(1) * inputs];
            let blocks = product
                .par_chunks_mut((BLOCK * inputs).max(1))
                .zip(g.par_chunks((BLOCK * width).max(1)));
            blocks.for_each(|(d, g)| product_with_transposed(g, width, weight, inputs, d));
            let mut d_x = vec![E::zero(); rows * inputs];
            for (r, d) in product.chunks_exact(inputs.max(1)).enumerate() {
                d_x[self.row(r) * inputs..][..inputs].copy_from_slice(d);
            }
            d_x
        });
        let below = self.upsample.apply_adjoint(&g, width);
        LayerGradients {
            x: d_x,
            weight: d_weight,
            below,
            bias: d_bias,
        }
    }
}

/// What [`LayerMap::adjoint`] gives, shaped like the inputs.
#[derive(Clone, Debug)]
pub struct LayerGradients<E> {
    /// Where it was asked for.
    pub x: Option<Vec<E>>,
    /// `[K, D]`.
    pub weight: Vec<E>,
    /// `[M, D]`.
    pub below: Vec<E>,
    /// `[D]`.
    pub bias: Vec<E>,
}

/// The tensors of a layer, or their gradients.
#[derive(Clone, Debug, ExtensionType)]
pub struct LayerTensors<B: Backend> {
    pub(super) x: FloatTensor<B>,
    pub(super) weight: FloatTensor<B>,
    pub(super) below: FloatTensor<B>,
    pub(super) bias: FloatTensor<B>,
}

/// Backend side of [`fusion_layer`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait FusionBackend: Backend {
    /// See [`LayerMap::apply`].
    fn fusion_layer(
        #[extension_type] tensors: LayerTensors<Self>,
        map: Arc<LayerMap>,
    ) -> FloatTensor<Self>;
    /// See [`LayerMap::adjoint`]; the gradient of `x` is an empty tensor unless `wants_x`.
    fn fusion_layer_adjoint(
        #[extension_type] tensors: LayerTensors<Self>,
        out: FloatTensor<Self>,
        g: FloatTensor<Self>,
        map: Arc<LayerMap>,
        wants_x: bool,
    ) -> LayerTensors<Self>;
}

impl<B: HostKernels> FusionBackend for B {
    fn fusion_layer(tensors: LayerTensors<Self>, map: Arc<LayerMap>) -> FloatTensor<Self> {
        on_host::fusion_layer::<Self>(tensors, &map)
    }

    fn fusion_layer_adjoint(
        tensors: LayerTensors<Self>,
        out: FloatTensor<Self>,
        g: FloatTensor<Self>,
        map: Arc<LayerMap>,
        wants_x: bool,
    ) -> LayerTensors<Self> {
        on_host::fusion_layer_adjoint::<Self>(tensors, out, g, &map, wants_x)
    }
}

/// The layer by the CPU's kernels, wherever the tensors live.
pub(super) mod on_host {
    use super::*;

    pub fn fusion_layer<B: HostBackend>(
        tensors: LayerTensors<B>,
        map: &LayerMap,
    ) -> FloatTensor<B> {
        let LayerTensors {
            x,
            weight,
            below,
            bias,
        } = tensors;
        let (device, shape) = (
            device_of::<B>(&bias),
            [map.upsample.rows(), bias.shape()[0]],
        );
        real_kernel!(bias, E => {
            let (x, weight, below) = (B::values::<E>(x), B::values::<E>(weight), B::values::<E>(below));
            B::tensor::<E>(map.apply::<E>(&x, &weight, &below, &B::values(bias)), &shape, &device)
        })
    }

    pub fn fusion_layer_adjoint<B: HostBackend>(
        tensors: LayerTensors<B>,
        out: FloatTensor<B>,
        g: FloatTensor<B>,
        map: &LayerMap,
        wants_x: bool,
    ) -> LayerTensors<B> {
        let LayerTensors {
            x,
            weight,
            below,
            bias,
        } = tensors;
        let device = device_of::<B>(&bias);
        let [rows, inputs] = x.shape().dims();
        let [coarse, width] = below.shape().dims();
        real_kernel!(bias, E => {
            let g = B::values::<E>(g).into_vec();
            let (x, weight, out) = (B::values::<E>(x), B::values::<E>(weight), B::values::<E>(out));
            let gradients = map.adjoint::<E>(&x, &weight, &out, g, width, wants_x.then_some(rows));
            let x_rows = if wants_x { rows } else { 0 };
            LayerTensors {
                x: B::tensor::<E>(gradients.x.unwrap_or_default(), &[x_rows, inputs], &device),
                weight: B::tensor::<E>(gradients.weight, &[inputs, width], &device),
                below: B::tensor::<E>(gradients.below, &[coarse, width], &device),
                bias: B::tensor::<E>(gradients.bias, &[width], &device),
            }
        })
    }
}

#[derive(Debug)]
struct FusionBackward;

impl<B: FusionBackend> Backward<B, 4> for FusionBackward {
    type State = (LayerTensors<B>, FloatTensor<B>, Arc<LayerMap>);

    fn backward(
        self,
        ops: Ops<Self::State, 4>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let (tensors, out, map) = ops.state;
        let [x, weight, below, bias] = ops.parents;
        let d = B::fusion_layer_adjoint(tensors, out, g, map, x.is_some());
        for (node, gradient) in [
            (x, d.x),
            (weight, d.weight),
            (below, d.below),
            (bias, d.bias),
        ] {
            if let Some(node) = node {
                grads.register::<B>(node.id, gradient);
            }
        }
    }
}

impl<B: FusionBackend, C: CheckpointStrategy> FusionBackend for Autodiff<B, C> {
    fn fusion_layer(tensors: LayerTensors<Self>, map: Arc<LayerMap>) -> FloatTensor<Self> {
        let (x, x_node) = tensors.x.into_parts();
        let (weight, weight_node) = tensors.weight.into_parts();
        let (below, below_node) = tensors.below.into_parts();
        let (bias, bias_node) = tensors.bias.into_parts();
        let tensors = LayerTensors::<B> {
            x,
            weight,
            below,
            bias,
        };
        let nodes = [x_node, weight_node, below_node, bias_node];
        match FusionBackward
            .prepare::<C>(nodes)
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let out = B::fusion_layer(tensors.clone(), map.clone());
                prep.finish((tensors, out.clone(), map), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::fusion_layer(tensors, map)),
        }
    }

    fn fusion_layer_adjoint(
        _tensors: LayerTensors<Self>,
        _out: FloatTensor<Self>,
        _g: FloatTensor<Self>,
        _map: Arc<LayerMap>,
        _wants_x: bool,
    ) -> LayerTensors<Self> {
        unimplemented!("second-order gradients")
    }
}

/// `leaky(x[rows] W + US y + b)`: `x` is `[.., K]`, `weight` `[K, D]`, `below` (y) `[M, D]`, `bias` `[D]`; the result is
/// `[R, D]`, with gradients to all four. K may be 0.
///
/// # Panics
/// If the shapes disagree, the tensors are not all with or all without autodiff, or are neither f32 nor f64, or a row is not one
/// of `x`.
pub fn fusion_layer(
    x: Tensor<2>,
    weight: Tensor<2>,
    below: Tensor<2>,
    bias: Tensor<1>,
    map: LayerMap,
) -> Tensor<2> {
    let ([rows, inputs], [coarse, width]) = (x.dims(), below.dims());
    let used = map.rows.as_ref().map_or(rows, |r| r.len());
    assert_eq!(
        (weight.dims(), bias.dims()),
        ([inputs, width], [width]),
        "fusion_layer: weight and bias"
    );
    assert_eq!(
        (used, coarse),
        (map.upsample.rows(), map.upsample.columns),
        "fusion_layer: rows against the upsampling"
    );
    let known = map.rows.as_ref().is_none_or(|used| used.end() <= rows);
    assert!(known, "fusion_layer: a row is not below {rows}");
    let tensors = LayerTensors {
        x: x.into_dispatch(),
        weight: weight.into_dispatch(),
        below: below.into_dispatch(),
        bias: bias.into_dispatch(),
    };
    Tensor::from_dispatch(Dispatch::fusion_layer(tensors, Arc::new(map)))
}

/// [`fusion_layer`] in plain tensors: the reference of its tests.
pub fn fusion_layer_plain(
    x: Tensor<2>,
    weight: Tensor<2>,
    below: Tensor<2>,
    bias: Tensor<1>,
    map: &LayerMap,
) -> Tensor<2> {
    let upsampled = sparse_apply(below, map.upsample.clone()) + bias.unsqueeze();
    let sum = match (weight.dims()[0], &map.rows) {
        (0, _) => upsampled,
        (_, None) => upsampled + x.matmul(weight),
        (_, Some(rows)) => {
            let index = rows.iter().map(|&r| i64::from(r)).collect();
            let index = Tensor::<1, Int>::from_data(
                TensorData::new::<i64, _>(index, [rows.len()]),
                &x.device(),
            );
            upsampled + x.select(0, index).matmul(weight)
        }
    };
    if map.slope == 1.0 {
        sum
    } else {
        leaky_relu(sum, map.slope)
    }
}
