//! Constant sparse matrices on a device: compressed rows, one unit for each row and channel.

use super::{SparseMatrix, cpu};
use crate::backend::gpu::{Gpu, launch};
use crate::ops::gpu::covers;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// The arrays of a [`SparseMatrix`].
#[derive(Clone)]
pub(super) struct DeviceMatrix {
    offsets: CubeTensor,
    indices: CubeTensor,
    values: CubeTensor,
    rows: usize,
}

#[cube(launch)]
fn multiply(
    offsets: &[u32],
    indices: &[u32],
    values: &[f32],
    x: &[f32],
    out: &mut [f32],
    rows: u32,
    channels: u32,
) {
    let row = ABSOLUTE_POS / channels as usize;
    let channel = ABSOLUTE_POS % channels as usize;
    if row >= rows as usize {
        terminate!();
    }
    let mut sum = 0.0f32;
    for at in offsets[row]..offsets[row + 1] {
        sum += values[at as usize] * x[indices[at as usize] as usize * channels as usize + channel];
    }
    out[row * channels as usize + channel] = sum;
}

impl DeviceMatrix {
    fn upload(gpu: &Gpu, matrix: &SparseMatrix) -> Self {
        Self {
            offsets: gpu.upload(&matrix.offsets),
            indices: gpu.upload(&matrix.indices),
            values: gpu.upload(&matrix.values),
            rows: matrix.rows(),
        }
    }

    fn is_on(&self, gpu: &Gpu) -> bool {
        self.values.device == gpu.device
    }

    /// `W x`, `[rows, channels]`.
    pub fn apply(&self, gpu: &Gpu, x: CubeTensor) -> CubeTensor {
        let channels = x.meta.shape()[1];
        let out = gpu.floats([self.rows, channels]);
        launch!(gpu, multiply, gpu.cubes_for(self.rows * channels);
            &self.offsets, &self.indices, &self.values, &into_contiguous(x), &out;
            self.rows as u32, channels as u32);
        out
    }
}

pub(super) fn sparse_apply(
    x: FloatTensor<CubeBackend>,
    matrix: Arc<SparseMatrix>,
) -> FloatTensor<CubeBackend> {
    if !covers(&x) || matrix.rows() * x.meta.num_elements() == 0 {
        return cpu::sparse_apply::<CubeBackend>(x, matrix);
    }
    let gpu = Gpu::of(&x);
    let upload = || DeviceMatrix::upload(&gpu, &matrix);
    let copy = matrix.by_rows.get(|copy| copy.is_on(&gpu), upload);
    copy.apply(&gpu, x)
}

pub(super) fn sparse_apply_adjoint(
    g: FloatTensor<CubeBackend>,
    matrix: Arc<SparseMatrix>,
) -> FloatTensor<CubeBackend> {
    if !covers(&g) || matrix.columns * g.meta.num_elements() == 0 {
        return cpu::sparse_apply_adjoint::<CubeBackend>(g, matrix);
    }
    let gpu = Gpu::of(&g);
    let upload = || DeviceMatrix::upload(&gpu, &matrix.transposed());
    let copy = matrix.by_columns.get(|copy| copy.is_on(&gpu), upload);
    copy.apply(&gpu, g)
}
