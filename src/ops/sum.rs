//! The sum of a tensor: burn's own in host memory, and in a fixed order on a GPU, where burn adds with atomics.

#[cfg(feature = "cube")]
use crate::backend::device::in_host_memory;
use burn::tensor::Tensor;
#[cfg(feature = "cube")]
use burn::{
    backend::{
        Autodiff, Backend, Dispatch, TensorMetadata,
        autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
        autodiff::grads::Gradients,
        autodiff::ops::{Backward, Ops, OpsKind},
        backend_extension,
        tensor::FloatTensor,
    },
    tensor::{DType, Shape},
};

/// Backend side of [`sum_all`] on a GPU.
#[cfg(feature = "cube")]
#[backend_extension(Cube: cfg(feature = "cube"), Autodiff)]
pub trait SumBackend: Backend {
    /// The sum `[1]` of all values.
    fn sum_all(x: FloatTensor<Self>) -> FloatTensor<Self>;
}

#[cfg(feature = "cube")]
#[derive(Debug)]
struct SumBackward;

#[cfg(feature = "cube")]
impl<B: SumBackend> Backward<B, 1> for SumBackward {
    type State = Shape;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let [parent] = ops.parents;
        if let Some(node) = parent {
            let ones = Shape::from(vec![1; ops.state.num_dims()]);
            grads.register::<B>(
                node.id,
                B::float_expand(B::float_reshape(g, ones), ops.state),
            );
        }
    }
}

#[cfg(feature = "cube")]
impl<B: SumBackend, C: CheckpointStrategy> SumBackend for Autodiff<B, C> {
    fn sum_all(x: FloatTensor<Self>) -> FloatTensor<Self> {
        let (x, node) = x.into_parts();
        match SumBackward.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(x.shape(), B::sum_all(x)),
            OpsKind::UnTracked(prep) => prep.finish(B::sum_all(x)),
        }
    }
}

/// The sum `[1]` of all values of `x`, with gradient to it; the same bits each time.
pub fn sum_all<const D: usize>(x: Tensor<D>) -> Tensor<1> {
    #[cfg(feature = "cube")]
    if !in_host_memory(&x.device()) && x.dtype() == DType::F32 {
        return Tensor::from_dispatch(Dispatch::sum_all(x.into_dispatch()));
    }
    x.sum()
}
