//! The glue between a custom operation and burn's backends.
//!
//! An operation is a folder: `mod.rs` has the public function on tensors and calls [`custom_op!`]. `cpu.rs` has a kernel that is
//! generic over [`HostBackend`](super::HostBackend). `gpu.rs` has a kernel on `CubeBackend`, behind the feature `cube`. The module
//! `autodiff` has the tracked version: one call of [`track`].
//!
//! ```ignore
//! #[cfg(feature = "cube")]
//! mod gpu; // pub fn scale(x: FloatTensor<CubeBackend>, factor: f64) -> FloatTensor<CubeBackend>
//! mod cpu; // pub fn scale<B: HostBackend>(x: FloatTensor<B>, factor: f64) -> FloatTensor<B>
//!
//! custom_op! {
//!     /// Backend side of [`scale`].
//!     pub(crate) trait ScaleBackend {
//!         /// `factor x`.
//!         fn scale(x: FloatTensor<Self>, factor: f64) -> FloatTensor<Self>;
//!     }
//!     backward {} // functions that only a backward pass calls
//! }
//!
//! mod autodiff {
//!     use super::ScaleBackend;
//!     pub fn scale<B: ScaleBackend, C: CheckpointStrategy>(x: AutodiffTensor<B, C>, factor: f64) -> AutodiffTensor<B, C> {
//!         track::<B, C, 1, _>([x], |[x]| {
//!             let backward = move |gradient, _wanted| [Some(B::scale(gradient, factor))];
//!             (B::scale(x, factor), backward)
//!         })
//!     }
//! }
//!
//! /// `factor x`, with gradients to `x`.
//! pub fn scale<const D: usize>(x: Tensor<D>, factor: f64) -> Tensor<D> {
//!     Tensor::from_dispatch(Dispatch::scale(x.into_dispatch(), factor))
//! }
//! ```

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, Backend, tensor::FloatTensor};
use std::fmt::{Debug, Formatter};

/// A float tensor in the autodiff graph over `B`.
pub(crate) type AutodiffTensor<B, C> = FloatTensor<Autodiff<B, C>>;

/// Declares the backend trait of an operation and implements it for every backend.
///
/// Each function `f` of the trait calls `cpu::f` on backends in host memory, `gpu::f` on a GPU, and `autodiff::f` in the
/// autodiff graph. Functions under `backward` have no gradient themselves. With `no_gradient` in place of `backward { .. }`, no
/// function has one. An argument that is a struct of tensors has the attribute `#[extension_type]`.
macro_rules! custom_op {
    (
        $(#[$meta:meta])*
        $vis:vis trait $name:ident { $($op:tt)* }
        backward { $($backward:tt)* }
    ) => {
        #[burn::backend::backend_extension(
            NdArray: cfg(feature = "ndarray"),
            Flex: cfg(feature = "flex"),
            Cube: cfg(feature = "cube"),
            Autodiff
        )]
        $(#[$meta])*
        $vis trait $name: burn::backend::Backend { $($op)* $($backward)* }
        $crate::backend::custom_op!(@kernels $name { $($op)* $($backward)* });
        $crate::backend::custom_op!(@autodiff $name { $($op)* } { $($backward)* });
    };
    (
        $(#[$meta:meta])*
        $vis:vis trait $name:ident { $($op:tt)* }
        no_gradient
    ) => {
        #[burn::backend::backend_extension(
            NdArray: cfg(feature = "ndarray"),
            Flex: cfg(feature = "flex"),
            Cube: cfg(feature = "cube")
        )]
        $(#[$meta])*
        $vis trait $name: burn::backend::Backend { $($op)* }
        $crate::backend::custom_op!(@kernels $name { $($op)* });
    };
    (@kernels $name:ident $functions:tt) => {
        #[cfg(feature = "ndarray")]
        $crate::backend::custom_op!(@calls $name, burn::backend::NdArray, cpu, [::<Self>], $functions);
        #[cfg(feature = "flex")]
        $crate::backend::custom_op!(@calls $name, burn::backend::Flex, cpu, [::<Self>], $functions);
        #[cfg(feature = "cube")]
        $crate::backend::custom_op!(@calls $name, burn_cubecl::CubeBackend, gpu, [], $functions);
    };
    (@calls $name:ident, $backend:ty, $kernels:ident, $generics:tt, {
        $(
            $(#[$meta:meta])*
            fn $function:ident($($(#[$extension:meta])* $arg:ident: $type:ty),* $(,)?) -> $out:ty;
        )*
    }) => {
        impl $name for $backend {
            $($crate::backend::custom_op!(
                @call $kernels, $function, $generics, [$($arg: $type),*], $out
            );)*
        }
    };
    (@call $kernels:ident, $function:ident, [$($generics:tt)*], [$($arg:ident: $type:ty),*], $out:ty) => {
        fn $function($($arg: $type),*) -> $out {
            $kernels::$function $($generics)* ($($arg),*)
        }
    };
    (@autodiff $name:ident {
        $(
            $(#[$meta:meta])*
            fn $function:ident($($(#[$extension:meta])* $arg:ident: $type:ty),* $(,)?) -> $out:ty;
        )*
    } {
        $(
            $(#[$back_meta:meta])*
            fn $back:ident($($(#[$back_extension:meta])* $back_arg:ident: $back_type:ty),* $(,)?) -> $back_out:ty;
        )*
    }) => {
        impl<B: $name, C: burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy> $name
            for burn::backend::Autodiff<B, C>
        {
            $(
                fn $function($($arg: $type),*) -> $out {
                    autodiff::$function::<B, C>($($arg),*)
                }
            )*
            $(
                fn $back($(_: $back_type),*) -> $back_out {
                    unimplemented!("second-order gradients")
                }
            )*
        }
    };
}
pub(crate) use custom_op;

/// The output of `forward` as a node of the autodiff graph whose parents are `inputs`.
///
/// `forward` gets the tensors without autodiff. It returns the output and the backward pass. The backward pass gets the output's
/// gradient and which inputs want a gradient; it returns the gradients of the inputs.
pub(crate) fn track<B, C, const N: usize, F>(
    inputs: [AutodiffTensor<B, C>; N],
    forward: impl FnOnce([FloatTensor<B>; N]) -> (FloatTensor<B>, F),
) -> AutodiffTensor<B, C>
where
    B: Backend,
    C: CheckpointStrategy,
    F: FnOnce(FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Clone + Send + 'static,
{
    let mut nodes = Vec::with_capacity(N);
    let inputs = inputs.map(|input| {
        let (tensor, node) = input.into_parts();
        nodes.push(node);
        tensor
    });
    let mut nodes = nodes.into_iter();
    let nodes = std::array::from_fn(|_| nodes.next().expect("one node an input"));
    let (output, backward) = forward(inputs);
    match Node(std::marker::PhantomData)
        .prepare::<C>(nodes)
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prep) => prep.finish(BackwardPass(backward), output),
        OpsKind::UnTracked(prep) => prep.finish(output),
    }
}

/// The backward pass of a node, with what it captured.
#[derive(Clone)]
struct BackwardPass<F>(F);

impl<F> Debug for BackwardPass<F> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("BackwardPass")
    }
}

/// A node made by [`track`].
struct Node<F>(std::marker::PhantomData<fn() -> F>);

impl<F> Debug for Node<F> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("Node")
    }
}

impl<B, F, const N: usize> Backward<B, N> for Node<F>
where
    B: Backend,
    F: FnOnce(FloatTensor<B>, [bool; N]) -> [Option<FloatTensor<B>>; N] + Clone + Send + 'static,
{
    type State = BackwardPass<F>;

    fn backward(
        self,
        ops: Ops<Self::State, N>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let gradient = grads.consume::<B>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let BackwardPass(backward) = ops.state;
        for (parent, gradient) in ops.parents.into_iter().zip(backward(gradient, wanted)) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                grads.register::<B>(parent.id, gradient);
            }
        }
    }
}
