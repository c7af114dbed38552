//! Rows read and written by their numbers, one unit a value.

use super::dense::zeros;
use crate::backend::gpu::{Gpu, arg};
use crate::ops::gather::{GatherBackend, RowList};
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// `out[r] = x[rows[r]]`.
#[cube(launch)]
fn gather(x: &[f32], rows: &[u32], out: &mut [f32], count: u32, width: u32) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        let row = rows[i / width as usize] as usize;
        out[i] = x[row * width as usize + i % width as usize];
    }
}

/// `out[rows[r]] = x[r]`, where no row is named twice.
#[cube(launch)]
fn scatter(x: &[f32], rows: &[u32], out: &mut [f32], count: u32, width: u32) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        let row = rows[i / width as usize] as usize;
        out[row * width as usize + i % width as usize] = x[i];
    }
}

impl RowList {
    /// The numbers on the device of `gpu`, of which there is at least one.
    pub(super) fn on(&self, gpu: &Gpu) -> CubeTensor {
        self.resident.on(gpu, || gpu.upload(self, DType::U32))
    }
}

impl GatherBackend for CubeBackend {
    fn gather_rows(x: FloatTensor<Self>, rows: Arc<RowList>) -> FloatTensor<Self> {
        let (gpu, width) = (Gpu::of(&x), x.meta.shape()[1]);
        let count = rows.len() * width;
        if count == 0 {
            return zeros(&gpu, [rows.len(), width]);
        }
        let (x, out) = (into_contiguous(x), gpu.floats([rows.len(), width]));
        let (cubes, index) = (gpu.cubes_for(count), rows.on(&gpu));
        let (count, width) = (count as u32, width as u32);
        gather::launch(
            &gpu.client,
            cubes,
            gpu.dim(),
            arg(&x),
            arg(&index),
            arg(&out),
            count,
            width,
        );
        out
    }

    fn scatter_rows(g: FloatTensor<Self>, rows: Arc<RowList>, total: usize) -> FloatTensor<Self> {
        let (gpu, width) = (Gpu::of(&g), g.meta.shape()[1]);
        let (out, count) = (
            into_contiguous(zeros(&gpu, [total, width])),
            rows.len() * width,
        );
        if count > 0 {
            let (g, cubes, index) = (into_contiguous(g), gpu.cubes_for(count), rows.on(&gpu));
            scatter::launch(
                &gpu.client,
                cubes,
                gpu.dim(),
                arg(&g),
                arg(&index),
                arg(&out),
                count as u32,
                width as u32,
            );
        }
        out
    }
}
