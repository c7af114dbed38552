//! Scalar losses that make their gradient together with their value, under autodiff.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, AutodiffBackend, Backend, tensor::FloatTensor};
use burn::tensor::Shape;

/// Scales the gradient to the one parent, `[R, C]`, by that of the loss.
#[derive(Debug)]
struct GradientInHand;

impl<B: Backend> Backward<B, 1> for GradientInHand {
    type State = FloatTensor<B>;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let [parent] = ops.parents;
        if let Some(node) = parent {
            let g = B::float_reshape(g, Shape::new([1, 1]));
            grads.register::<B>(node.id, B::float_mul(ops.state, g));
        }
    }
}

/// A loss `[1]` and its gradient.
type WithGradient<B> = (FloatTensor<B>, FloatTensor<B>);

/// The loss of `parent` and its gradient, a constant, as `make` gives them on the inner backend.
pub(super) fn with_gradient_in_hand<B: Backend, C: CheckpointStrategy>(
    parent: FloatTensor<Autodiff<B, C>>,
    make: impl FnOnce(FloatTensor<B>) -> WithGradient<B>,
) -> WithGradient<Autodiff<B, C>> {
    let (parent, node) = parent.into_parts();
    let (value, gradient) = make(parent);
    let constant = <Autodiff<B, C> as AutodiffBackend>::from_inner(gradient.clone());
    let value = match GradientInHand
        .prepare::<C>([node])
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prep) => prep.finish(gradient, value),
        OpsKind::UnTracked(prep) => prep.finish(value),
    };
    (value, constant)
}
