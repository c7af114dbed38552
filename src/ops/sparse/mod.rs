//! Constant sparse linear maps.
//!
//! With frozen geometry blending is such a map (`S = W s`), and so are the interpolation of Eq. 7 and the sums over
//! neighbours of Eq. 9. The gradient with respect to the input is the adjoint `W^T g`; the matrix itself gets none.

mod cpu;
#[cfg(feature = "cube")]
mod gpu;
#[cfg(not(feature = "cube"))]
mod gpu {
    pub(super) type DeviceMatrix = ();
}
mod matrix;

pub use self::matrix::SparseMatrix;

use crate::backend::custom_op;
use crate::backend::device::indices;
use crate::ops::CustomOp;
use burn::backend::{Dispatch, tensor::FloatTensor};
use burn::tensor::{IndexingUpdateOp, Tensor, TensorData};
use std::sync::Arc;

custom_op! {
    /// Backend side of [`sparse_apply`].
    pub trait SparseBackend {
        /// `W x`, see [`SparseMatrix::apply`].
        fn sparse_apply(x: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self>;
    }
    backward {
        /// `W^T g`, see [`SparseMatrix::apply_adjoint`].
        fn sparse_apply_adjoint(g: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self>;
    }
}

mod autodiff {
    use super::{SparseBackend, SparseMatrix};
    use crate::backend::{AutodiffTensor, track};
    use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
    use std::sync::Arc;

    pub fn sparse_apply<B: SparseBackend, C: CheckpointStrategy>(
        x: AutodiffTensor<B, C>,
        matrix: Arc<SparseMatrix>,
    ) -> AutodiffTensor<B, C> {
        track::<B, C, 1, _>([x], |[x]| {
            let out = B::sparse_apply(x, matrix.clone());
            let backward = move |g, _wanted| [Some(B::sparse_apply_adjoint(g, matrix))];
            (out, backward)
        })
    }
}

/// `W x` with gradients to `x`: `x` is `[columns, channels]`, the result `[rows, channels]`.
///
/// # Panics
/// If `x` has a different number of rows than the matrix has columns.
pub fn sparse_apply(x: Tensor<2>, matrix: Arc<SparseMatrix>) -> Tensor<2> {
    assert_eq!(
        x.dims()[0],
        matrix.columns,
        "sparse_apply: rows of x against columns of the matrix"
    );
    if CustomOp::Sparse.is_replaced() {
        return sparse_apply_plain(x, &matrix);
    }
    Tensor::from_dispatch(Dispatch::sparse_apply(x.into_dispatch(), matrix))
}

/// The same product in plain tensor operations: the reference of [`sparse_apply`].
pub fn sparse_apply_plain(x: Tensor<2>, matrix: &SparseMatrix) -> Tensor<2> {
    let device = x.device();
    let channels = x.dims()[1];
    let out = Tensor::zeros([matrix.rows(), channels], (&device, x.dtype()));
    let (columns, values) = matrix.entries();
    if values.is_empty() || channels == 0 {
        return out + x.sum().unsqueeze() * 0.0;
    }
    let rows = (0..matrix.rows()).flat_map(|r| vec![r as u32; matrix.row(r).0.len()]);
    let rows: Vec<u32> = rows.collect();
    let weights = TensorData::new(values.to_vec(), [values.len(), 1]);
    let weights = Tensor::<2>::from_data(weights, (&device, x.dtype()));
    let terms = x.select(0, indices(columns, &device)) * weights;
    out.select_assign(0, indices(&rows, &device), terms, IndexingUpdateOp::Add)
}

/// The rows `rows` of `features`, with gradient to them.
pub(crate) fn select(features: &Tensor<2>, rows: &[u32]) -> Tensor<2> {
    let rows = SparseMatrix::selection(rows.to_vec(), features.dims()[0]);
    selected(features, &Arc::new(rows))
}

/// The rows of `features` that `selection` reads, with gradient to them.
pub(crate) fn selected(features: &Tensor<2>, selection: &Arc<SparseMatrix>) -> Tensor<2> {
    if features.dims()[1] == 0 || selection.rows() == 0 {
        // Some backends refuse tensors without values.
        return Tensor::zeros([selection.rows(), 0], &features.device());
    }
    sparse_apply(features.clone(), selection.clone())
}
