//! Constant sparse linear maps.
//!
//! With frozen geometry blending is such a map (`S = W s`), and so are the interpolation of Eq. 7 and the sums over
//! neighbours of Eq. 9. The gradient with respect to the input is the adjoint `W^T g`; the matrix itself gets none.

mod cpu;
#[cfg(feature = "cube")]
mod gpu;
mod matrix;

pub use self::matrix::SparseMatrix;

use crate::backend::HostKernels;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, Backend, Dispatch, backend_extension, tensor::FloatTensor};
use burn::tensor::{IndexingUpdateOp, Int, Tensor, TensorData};
use std::sync::Arc;

/// Backend side of [`sparse_apply`].
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube"),
    Autodiff
)]
pub trait SparseBackend: Backend {
    /// `W x`, see [`SparseMatrix::apply`].
    fn sparse_apply(x: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self>;
    /// `W^T g`, see [`SparseMatrix::apply_adjoint`].
    fn sparse_apply_adjoint(g: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self>;
}

impl<B: HostKernels> SparseBackend for B {
    fn sparse_apply(x: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self> {
        cpu::apply::<Self>(x, &matrix)
    }
    fn sparse_apply_adjoint(g: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self> {
        cpu::apply_adjoint::<Self>(g, &matrix)
    }
}

#[derive(Debug)]
struct SparseBackward;

impl<B: SparseBackend> Backward<B, 1> for SparseBackward {
    type State = Arc<SparseMatrix>;

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let [parent] = ops.parents;
        if let Some(node) = parent {
            grads.register::<B>(node.id, B::sparse_apply_adjoint(g, ops.state));
        }
    }
}

impl<B: SparseBackend, C: CheckpointStrategy> SparseBackend for Autodiff<B, C> {
    fn sparse_apply(x: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self> {
        let (x, node) = x.into_parts();
        match SparseBackward
            .prepare::<C>([node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let out = B::sparse_apply(x, matrix.clone());
                prep.finish(matrix, out)
            }
            OpsKind::UnTracked(prep) => prep.finish(B::sparse_apply(x, matrix)),
        }
    }

    fn sparse_apply_adjoint(
        _g: FloatTensor<Self>,
        _matrix: Arc<SparseMatrix>,
    ) -> FloatTensor<Self> {
        unimplemented!("second-order gradients")
    }
}

/// `W x` with gradients to `x`: `x` is `[columns, channels]`, the result `[rows, channels]`.
///
/// # Panics
/// If `x` has another number of rows than the matrix has columns.
pub fn sparse_apply(x: Tensor<2>, matrix: Arc<SparseMatrix>) -> Tensor<2> {
    assert_eq!(
        x.dims()[0],
        matrix.columns,
        "sparse_apply: rows of x against columns of the matrix"
    );
    if super::references() {
        return sparse_apply_plain(x, &matrix);
    }
    Tensor::from_dispatch(Dispatch::sparse_apply(x.into_dispatch(), matrix))
}

/// The same product in plain tensor operations: the reference of [`sparse_apply`].
pub fn sparse_apply_plain(x: Tensor<2>, matrix: &SparseMatrix) -> Tensor<2> {
    let (device, channels) = (x.device(), x.dims()[1]);
    let out = Tensor::zeros([matrix.rows(), channels], (&device, x.dtype()));
    let (columns, values) = matrix.entries();
    if values.is_empty() || channels == 0 {
        return out + x.sum().unsqueeze() * 0.0;
    }
    let numbers = |numbers: Vec<i64>| {
        let data = TensorData::new(numbers, [values.len()]);
        Tensor::<1, Int>::from_data(data, &device)
    };
    let columns = columns.iter().map(|&column| i64::from(column));
    let rows = (0..matrix.rows()).flat_map(|r| vec![r as i64; matrix.row(r).0.len()]);
    let weights = TensorData::new(values.to_vec(), [values.len(), 1]);
    let weights = Tensor::<2>::from_data(weights, (&device, x.dtype()));
    let terms = x.select(0, numbers(columns.collect())) * weights;
    out.select_assign(0, numbers(rows.collect()), terms, IndexingUpdateOp::Add)
}
