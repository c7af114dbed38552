//! A dense map of rows, `x W + b`: burn's own, with a gradient of the weights by a kernel of this crate on a GPU.
//!
//! Matrices here are as tall as the scene and some hundred wide at most. For such shapes burn gives the gradient of the weights,
//! a sum over all rows, to a handful of cubes, and that of the bias to one unit a column.

#[cfg(feature = "cube")]
use crate::backend::device::in_host_memory;
use burn::tensor::Tensor;
use burn::tensor::module::linear;
#[cfg(feature = "cube")]
use burn::{
    backend::{
        Autodiff, Backend, Dispatch,
        autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
        autodiff::grads::Gradients,
        autodiff::ops::{Backward, Ops, OpsKind},
        backend_extension,
        tensor::FloatTensor,
    },
    tensor::DType,
};

/// Backend side of [`dense`] on a GPU.
#[cfg(feature = "cube")]
#[backend_extension(Cube: cfg(feature = "cube"), Autodiff)]
pub trait DenseBackend: Backend {
    /// `x W + b`, `[R, D]`: `x` is `[R, K]`, `weight` `[K, D]`, `bias` `[D]`, or `[0]` for none.
    fn dense(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
    /// `g W^T`, `[R, K]`.
    fn dense_inputs_gradient(g: FloatTensor<Self>, weight: FloatTensor<Self>) -> FloatTensor<Self>;
    /// `x^T g`, `[K, D]`, and the sum of the rows of `g`, `[D]`, which means something only `with_bias`.
    fn dense_weights_gradient(
        x: FloatTensor<Self>,
        g: FloatTensor<Self>,
        with_bias: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

#[cfg(feature = "cube")]
#[derive(Debug)]
struct DenseBackward;

#[cfg(feature = "cube")]
impl<B: DenseBackend> Backward<B, 3> for DenseBackward {
    type State = (FloatTensor<B>, FloatTensor<B>);

    fn backward(
        self,
        ops: Ops<Self::State, 3>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let (x, weight) = ops.state;
        let [x_node, weight_node, bias_node] = ops.parents;
        if let Some(node) = x_node {
            grads.register::<B>(node.id, B::dense_inputs_gradient(g.clone(), weight));
        }
        if weight_node.is_some() || bias_node.is_some() {
            let (d_weight, d_bias) = B::dense_weights_gradient(x, g, bias_node.is_some());
            for (node, gradient) in [(weight_node, d_weight), (bias_node, d_bias)] {
                if let Some(node) = node {
                    grads.register::<B>(node.id, gradient);
                }
            }
        }
    }
}

#[cfg(feature = "cube")]
impl<B: DenseBackend, C: CheckpointStrategy> DenseBackend for Autodiff<B, C> {
    fn dense(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let (x, x_node) = x.into_parts();
        let (weight, weight_node) = weight.into_parts();
        let (bias, bias_node) = bias.into_parts();
        match DenseBackward
            .prepare::<C>([x_node, weight_node, bias_node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let out = B::dense(x.clone(), weight.clone(), bias);
                prep.finish((x, weight), out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::dense(x, weight, bias)),
        }
    }

    fn dense_inputs_gradient(
        _g: FloatTensor<Self>,
        _weight: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        unimplemented!("second-order gradients")
    }

    fn dense_weights_gradient(
        _x: FloatTensor<Self>,
        _g: FloatTensor<Self>,
        _with_bias: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        unimplemented!("second-order gradients")
    }
}

/// `x W + b`, `[R, D]`, with gradients to all: `x` is `[R, K]`, `weight` `[K, D]`, `bias` `[D]`.
///
/// # Panics
/// If the shapes disagree, or the tensors are not all with or all without autodiff.
pub fn dense(x: Tensor<2>, weight: Tensor<2>, bias: Option<Tensor<1>>) -> Tensor<2> {
    let ([_, inputs], [expected, width]) = (x.dims(), weight.dims());
    assert_eq!(inputs, expected, "dense: inputs against rows of the weight");
    assert!(
        bias.as_ref().is_none_or(|bias| bias.dims() == [width]),
        "dense: bias against columns of the weight"
    );
    #[cfg(feature = "cube")]
    if !in_host_memory(&x.device()) && x.dtype() == DType::F32 {
        let bias = bias.unwrap_or_else(|| Tensor::empty([0], &x.device()));
        let out = Dispatch::dense(
            x.into_dispatch(),
            weight.into_dispatch(),
            bias.into_dispatch(),
        );
        return Tensor::from_dispatch(out);
    }
    match bias {
        Some(bias) => linear(x, weight, Some(bias)),
        None => x.matmul(weight),
    }
}
