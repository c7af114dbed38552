//! Constant sparse linear maps as a differentiable burn operation.
//!
//! With frozen geometry, blending (`S = W s`) and distance-weighted interpolation are both such maps. The gradient
//! with respect to the input is the adjoint `W^T g`; the matrix itself gets none.

#[cfg(feature = "cube")]
use super::gpu::DeviceMatrix;
#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
use crate::backend::simd::{multiply_add, wide_kernel};
use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{
    Autodiff, Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor,
};
use burn::tensor::Tensor;
use rayon::prelude::*;
use std::sync::Arc;

/// At most this many channels are handled together: one cache line of f32.
const LANES: usize = 16;

/// Rows of a task.
const BLOCK: usize = 64;

wide_kernel! {
    /// `out[k, :] += sum_j W[first + k, j] x[j, :]`.
    fn rows_kernel(w: &SparseMatrix, first: usize, x: &[E], channels: usize, out: &mut [E]) => rows_body
}
wide_kernel! {
    /// `sum[j, :] += W[r, j] g[r, first..first + width]` over all rows r in order.
    fn adjoint_kernel(w: &SparseMatrix, g: &[E], channels: usize, first: usize, width: usize, sum: &mut [E]) => adjoint_body
}

#[inline(always)]
fn rows_body<E: Real, const FMA: bool>(
    w: &SparseMatrix,
    first: usize,
    x: &[E],
    channels: usize,
    out: &mut [E],
) {
    for (k, out) in out.chunks_exact_mut(channels).enumerate() {
        let (columns, values) = w.row(first + k);
        for (&c, &v) in columns.iter().zip(values) {
            axpy::<E, FMA>(
                E::of(f64::from(v)),
                &x[c as usize * channels..][..channels],
                out,
            );
        }
    }
}

#[inline(always)]
fn adjoint_body<E: Real, const FMA: bool>(
    w: &SparseMatrix,
    g: &[E],
    channels: usize,
    first: usize,
    width: usize,
    sum: &mut [E],
) {
    for r in 0..w.rows() {
        let g = &g[r * channels + first..][..width];
        let (columns, values) = w.row(r);
        for (&c, &v) in columns.iter().zip(values) {
            axpy::<E, FMA>(
                E::of(f64::from(v)),
                g,
                &mut sum[c as usize * width..][..width],
            );
        }
    }
}

#[inline(always)]
fn axpy<E: Real, const FMA: bool>(a: E, x: &[E], y: &mut [E]) {
    for (y, &x) in y.iter_mut().zip(x) {
        *y = multiply_add::<E, FMA>(a, x, *y);
    }
}

/// A constant sparse matrix in compressed rows, `[rows, columns]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseMatrix {
    // Not to be changed: a device may hold copies.
    pub(crate) columns: usize,
    /// Start of each row in `indices`; `rows + 1` entries, the first 0, ascending.
    pub(crate) offsets: Vec<u32>,
    /// Column of each entry.
    pub(crate) indices: Vec<u32>,
    /// Value of each entry.
    pub(crate) values: Vec<f32>,
    #[cfg(feature = "cube")]
    pub(super) resident: ResidentMatrix,
}

/// Copies of a matrix on a device.
#[cfg(feature = "cube")]
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ResidentMatrix {
    /// By rows, and by columns.
    pub rows: Resident<DeviceMatrix>,
    pub columns: Resident<DeviceMatrix>,
}

impl SparseMatrix {
    /// Of compressed rows: `offsets` holds the start of each row in `indices`, and the end of the last.
    ///
    /// # Panics
    /// If `offsets` does not rise from 0 to the number of entries, `indices` and `values` differ in length, or an index is
    /// not below `columns`.
    pub fn new(columns: usize, offsets: Vec<u32>, indices: Vec<u32>, values: Vec<f32>) -> Self {
        assert_eq!(
            indices.len(),
            values.len(),
            "sparse matrix: indices against values"
        );
        let (first, last) = (
            offsets.first().map(|&o| o as usize),
            offsets.last().map(|&o| o as usize),
        );
        assert_eq!(
            (first, last),
            (Some(0), Some(indices.len())),
            "sparse matrix: offsets against entries"
        );
        assert!(offsets.is_sorted(), "sparse matrix: offsets that fall");
        assert!(
            indices.iter().all(|&i| (i as usize) < columns),
            "sparse matrix: an index is not below {columns}"
        );
        Self::unchecked(columns, offsets, indices, values)
    }

    /// [`SparseMatrix::new`] of what is right by construction.
    pub(crate) fn unchecked(
        columns: usize,
        offsets: Vec<u32>,
        indices: Vec<u32>,
        values: Vec<f32>,
    ) -> Self {
        Self {
            columns,
            offsets,
            indices,
            values,
            #[cfg(feature = "cube")]
            resident: ResidentMatrix::default(),
        }
    }

    /// The rows `rows` of what has `columns` rows, in that order.
    ///
    /// # Panics
    /// If a row is not below `columns`.
    pub fn selection(rows: Vec<u32>, columns: usize) -> Self {
        let (offsets, ones) = ((0..=rows.len() as u32).collect(), vec![1.0; rows.len()]);
        Self::new(columns, offsets, rows, ones)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Columns and values of all entries, row by row.
    pub fn entries(&self) -> (&[u32], &[f32]) {
        (&self.indices, &self.values)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.offsets.len() + self.indices.len() + self.values.len())
    }

    /// Entries of row `r` as (columns, values).
    pub fn row(&self, r: usize) -> (&[u32], &[f32]) {
        let span = self.offsets[r] as usize..self.offsets[r + 1] as usize;
        (&self.indices[span.clone()], &self.values[span])
    }

    /// `out += W[first.., :] x`, as many rows as `out` holds: `x` is `[columns, channels]`.
    pub(super) fn add_rows<E: Real>(&self, first: usize, x: &[E], channels: usize, out: &mut [E]) {
        if channels > 0 {
            rows_kernel(self, first, x, channels, out);
        }
    }

    /// `W x`: `x` is `[columns, channels]` row-major, the result `[rows, channels]`.
    pub fn apply<E: Real>(&self, x: &[E], channels: usize) -> Vec<E> {
        let mut out = vec![E::zero(); self.rows() * channels];
        if channels == 0 {
            return out;
        }
        out.par_chunks_mut(channels * BLOCK)
            .enumerate()
            .for_each(|(block, out)| rows_kernel(self, block * BLOCK, x, channels, out));
        out
    }

    /// `W^T g`: `g` is `[rows, channels]` row-major, the result `[columns, channels]`.
    ///
    /// Threads own disjoint channel ranges and walk the rows in order, so the sums do not depend on their number.
    pub fn apply_adjoint<E: Real>(&self, g: &[E], channels: usize) -> Vec<E> {
        let mut out = vec![E::zero(); self.columns * channels];
        let count = channels.div_ceil(LANES);
        let even = channels.div_ceil(count.max(1));
        let blocks: Vec<Vec<E>> = (0..count)
            .into_par_iter()
            .map(|block| {
                let first = block * even;
                let width = even.min(channels - first);
                let mut sum = vec![E::zero(); self.columns * width];
                adjoint_kernel(self, g, channels, first, width, &mut sum);
                sum
            })
            .collect();
        if channels > 0 {
            out.par_chunks_mut(channels)
                .enumerate()
                .for_each(|(c, out)| {
                    for (out, block) in out.chunks_mut(even).zip(&blocks) {
                        out.copy_from_slice(&block[c * out.len()..][..out.len()]);
                    }
                });
        }
        out
    }
}

/// Rows and columns of a matrix that a computation needs, see [`SparseMatrix::compact`].
#[derive(Clone, Debug, PartialEq)]
pub struct Compact {
    /// The chosen rows over the used columns only.
    pub matrix: SparseMatrix,
    /// For each column of [`Compact::matrix`], the column of the original; ascending.
    pub columns: Vec<u32>,
}

impl SparseMatrix {
    /// The same matrix with each row divided by its sum; rows that sum to less than `floor` become empty.
    ///
    /// Of blending weights this makes weighted means: a row sums to `1 - T`.
    #[must_use]
    pub fn normalised(&self, floor: f32) -> Self {
        let mut out = Self::unchecked(self.columns, vec![0], Vec::new(), Vec::new());
        for r in 0..self.rows() {
            let (columns, values) = self.row(r);
            let sum: f32 = values.iter().sum();
            if sum >= floor && sum > 0.0 {
                out.indices.extend_from_slice(columns);
                out.values.extend(values.iter().map(|v| v / sum));
            }
            out.offsets.push(out.indices.len() as u32);
        }
        out
    }

    /// The rows `rows` in that order.
    #[must_use]
    pub fn select_rows(&self, rows: &[u32]) -> Self {
        let mut out = Self::unchecked(
            self.columns,
            Vec::with_capacity(rows.len() + 1),
            Vec::new(),
            Vec::new(),
        );
        out.offsets.push(0);
        out.append_rows(self, rows);
        out
    }

    /// Adds the rows `rows` of `other`, in that order.
    ///
    /// # Panics
    /// If `other` has another number of columns.
    pub fn append_rows(&mut self, other: &Self, rows: &[u32]) {
        assert_eq!(self.columns, other.columns, "append_rows: columns");
        for &r in rows {
            let (columns, values) = other.row(r as usize);
            self.indices.extend_from_slice(columns);
            self.values.extend_from_slice(values);
            self.offsets.push(self.indices.len() as u32);
        }
        #[cfg(feature = "cube")]
        {
            self.resident = ResidentMatrix::default();
        }
    }

    /// The matrix over `columns` (ascending, below [`SparseMatrix::columns`]) alone.
    ///
    /// # Panics
    /// If an entry lies in another column.
    #[must_use]
    pub fn over_columns(mut self, columns: &[u32]) -> Self {
        let mut place = vec![u32::MAX; self.columns];
        for (i, &c) in columns.iter().enumerate() {
            place[c as usize] = i as u32;
        }
        for c in &mut self.indices {
            *c = place[*c as usize];
        }
        assert!(
            !self.indices.contains(&u32::MAX),
            "over_columns: an entry in a column that is left out"
        );
        Self::unchecked(columns.len(), self.offsets, self.indices, self.values)
    }

    /// The matrix over its used columns, and which those are.
    #[must_use]
    pub fn compact(self) -> Compact {
        let mut place = vec![u32::MAX; self.columns];
        for &c in &self.indices {
            place[c as usize] = 0;
        }
        let mut columns = Vec::new();
        for (c, place) in place.iter_mut().enumerate() {
            if *place == 0 {
                *place = columns.len() as u32;
                columns.push(c as u32);
            }
        }
        let indices = self.indices.iter().map(|&c| place[c as usize]).collect();
        Compact {
            matrix: Self::unchecked(columns.len(), self.offsets, indices, self.values),
            columns,
        }
    }

    /// The transposed matrix; the entries of its rows ascend.
    #[must_use]
    pub fn transposed(&self) -> Self {
        let mut offsets = vec![0_u32; self.columns + 1];
        for &c in &self.indices {
            offsets[c as usize + 1] += 1;
        }
        for c in 0..self.columns {
            offsets[c + 1] += offsets[c];
        }
        let mut next = offsets.clone();
        let (mut indices, mut values) = (vec![0; self.indices.len()], vec![0.0; self.values.len()]);
        for r in 0..self.rows() {
            let (columns, row) = self.row(r);
            for (&c, &v) in columns.iter().zip(row) {
                let at = next[c as usize] as usize;
                (indices[at], values[at]) = (r as u32, v);
                next[c as usize] += 1;
            }
        }
        Self::unchecked(self.rows(), offsets, indices, values)
    }
}

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
        on_host::apply::<Self>(x, &matrix)
    }
    fn sparse_apply_adjoint(g: FloatTensor<Self>, matrix: Arc<SparseMatrix>) -> FloatTensor<Self> {
        on_host::apply_adjoint::<Self>(g, &matrix)
    }
}

/// The products by the CPU's kernels, wherever the tensor lives.
pub(super) mod on_host {
    use super::*;

    pub fn apply<B: HostBackend>(x: FloatTensor<B>, matrix: &SparseMatrix) -> FloatTensor<B> {
        let (device, channels) = (device_of::<B>(&x), x.shape()[1]);
        real_kernel!(x, E => B::tensor::<E>(matrix.apply::<E>(&B::values(x), channels), &[matrix.rows(), channels], &device))
    }

    pub fn apply_adjoint<B: HostBackend>(
        g: FloatTensor<B>,
        matrix: &SparseMatrix,
    ) -> FloatTensor<B> {
        let (device, channels) = (device_of::<B>(&g), g.shape()[1]);
        real_kernel!(g, E => B::tensor::<E>(matrix.apply_adjoint::<E>(&B::values(g), channels), &[matrix.columns, channels], &device))
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
    Tensor::from_dispatch(Dispatch::sparse_apply(x.into_dispatch(), matrix))
}
