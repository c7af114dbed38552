//! Rows of a matrix, and lists of their numbers that stay on a device.

#[cfg(feature = "cube")]
use super::sparse::{SparseBackend, SparseMatrix};
#[cfg(feature = "cube")]
use crate::backend::device::in_host_memory;
#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
use burn::tensor::{Int, Tensor, TensorData};
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
    tensor::DType,
};
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;
use std::ops::Deref;
use std::sync::Arc;

/// Numbers of rows, `[R]`, in any order; a device that reads them keeps a copy.
#[derive(Clone, Debug, PartialEq)]
pub struct RowList {
    // Not to be changed: a device may hold a copy.
    rows: Vec<u32>,
    /// Above all of them.
    end: usize,
    /// Whether each is above the one before.
    ascending: bool,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<CubeTensor>,
}

impl RowList {
    /// One more than the largest row, 0 where there is none: what has these rows has as many or more.
    pub fn end(&self) -> usize {
        self.end
    }

    /// Whether each row is above the one before, so that none is named twice.
    pub fn is_ascending(&self) -> bool {
        self.ascending
    }
}

impl Default for RowList {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl From<Vec<u32>> for RowList {
    fn from(rows: Vec<u32>) -> Self {
        Self {
            end: rows.iter().max().map_or(0, |&last| last as usize + 1),
            ascending: rows.windows(2).all(|pair| pair[0] < pair[1]),
            rows,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
        }
    }
}

impl Deref for RowList {
    type Target = [u32];
    fn deref(&self) -> &[u32] {
        &self.rows
    }
}

/// Backend side of [`gather_rows`] on a GPU.
#[cfg(feature = "cube")]
#[backend_extension(Cube: cfg(feature = "cube"), Autodiff)]
pub trait GatherBackend: Backend {
    /// `x[rows]`, `[R, C]`: `x` is `[.., C]`.
    fn gather_rows(x: FloatTensor<Self>, rows: Arc<RowList>) -> FloatTensor<Self>;
    /// The `[count, C]` whose rows `rows` are those of `g`, `[R, C]`, and the others 0; none of `rows` is named twice.
    fn scatter_rows(g: FloatTensor<Self>, rows: Arc<RowList>, count: usize) -> FloatTensor<Self>;
}

#[cfg(feature = "cube")]
#[derive(Debug)]
struct GatherBackward;

#[cfg(feature = "cube")]
impl<B: GatherBackend + SparseBackend> Backward<B, 1> for GatherBackward {
    type State = (Arc<RowList>, usize);

    fn backward(
        self,
        ops: Ops<Self::State, 1>,
        grads: &mut Gradients,
        _checkpointer: &mut Checkpointer,
    ) {
        let g = grads.consume::<B>(&ops.node);
        let (rows, count) = ops.state;
        let [parent] = ops.parents;
        let Some(node) = parent else { return };
        let gradient = match rows.is_ascending() {
            true => B::scatter_rows(g, rows, count),
            // A row that is named twice gets a sum.
            false => {
                B::sparse_apply_adjoint(g, Arc::new(SparseMatrix::selection(rows.to_vec(), count)))
            }
        };
        grads.register::<B>(node.id, gradient);
    }
}

#[cfg(feature = "cube")]
impl<B: GatherBackend + SparseBackend, C: CheckpointStrategy> GatherBackend for Autodiff<B, C> {
    fn gather_rows(x: FloatTensor<Self>, rows: Arc<RowList>) -> FloatTensor<Self> {
        let (x, node) = x.into_parts();
        match GatherBackward
            .prepare::<C>([node])
            .compute_bound()
            .stateful()
        {
            OpsKind::Tracked(prep) => {
                let state = (rows.clone(), x.shape()[0]);
                prep.finish(state, B::gather_rows(x, rows))
            }
            OpsKind::UnTracked(prep) => prep.finish(B::gather_rows(x, rows)),
        }
    }

    fn scatter_rows(
        _g: FloatTensor<Self>,
        _rows: Arc<RowList>,
        _count: usize,
    ) -> FloatTensor<Self> {
        unimplemented!("second-order gradients")
    }
}

/// The rows `rows` of `x`, `[R, channels]`, with gradient to `x`.
///
/// burn's own selection adds up the gradient of a column in one unit of a GPU, row after row.
///
/// # Panics
/// If a row is not one of `x`.
pub fn gather_rows(x: Tensor<2>, rows: &Arc<RowList>) -> Tensor<2> {
    let (device, count) = (x.device(), x.dims()[0]);
    assert!(
        rows.end() <= count,
        "gather_rows: a row is not below {count}"
    );
    #[cfg(feature = "cube")]
    if !in_host_memory(&device) && x.dtype() == DType::F32 {
        return Tensor::from_dispatch(Dispatch::gather_rows(x.into_dispatch(), rows.clone()));
    }
    let index: Vec<i64> = rows.iter().map(|&row| i64::from(row)).collect();
    x.select(
        0,
        Tensor::<1, Int>::from_data(TensorData::new(index, [rows.len()]), &device.inner()),
    )
}
