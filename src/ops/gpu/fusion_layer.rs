//! A layer of the decoder on a device: rows gathered, one product, and the rest in one pass.

use super::sparse::DeviceMatrix;
use super::{covers, own};
use crate::gpu::{Gpu, arg};
use crate::ops::fusion_layer::{FusionBackend, LayerMap, LayerTensors, on_host};
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

/// `out[r] = x[rows[r]]`, one unit a value.
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

/// `leaky(product + US y + b)`, one unit a value.
#[cube(launch)]
fn add_and_bend(
    product: &[f32],
    offsets: &[u32],
    indices: &[u32],
    values: &[f32],
    below: &[f32],
    bias: &[f32],
    out: &mut [f32],
    count: u32,
    width: u32,
    slope: f32,
    #[comptime] with_product: bool,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let row = i / width as usize;
    let column = i % width as usize;
    let mut sum = bias[column];
    for at in offsets[row]..offsets[row + 1] {
        sum += values[at as usize] * below[indices[at as usize] as usize * width as usize + column];
    }
    if comptime![with_product] {
        sum += product[i];
    }
    if sum <= 0.0f32 {
        sum *= slope;
    }
    out[i] = sum;
}

/// The gradient of what was bent: `g`, times the slope where `out` is not above 0.
#[cube(launch)]
fn unbend(out: &[f32], g: &mut [f32], count: u32, slope: f32) {
    let i = ABSOLUTE_POS;
    if i < count as usize && out[i] <= 0.0f32 {
        g[i] *= slope;
    }
}

/// `x[rows]`, or `x` where all rows are read.
fn gathered(gpu: &Gpu, x: &CubeTensor, map: &LayerMap) -> CubeTensor {
    let Some(rows) = &map.rows else { return x.clone() };
    let width = x.meta.shape()[1];
    let out = gpu.floats([rows.len(), width]);
    let index = gpu.upload(rows, DType::U32);
    let count = rows.len() * width;
    gather::launch(
        &gpu.client,
        gpu.cubes_for(count),
        gpu.dim(),
        arg(&into_contiguous(x.clone())),
        arg(&index),
        arg(&out),
        count as u32,
        width as u32,
    );
    out
}

/// Whether kernels take this layer: something comes out.
fn on_device(tensors: &LayerTensors<CubeBackend>, map: &LayerMap) -> bool {
    covers(&tensors.bias) && map.upsample.rows() * tensors.bias.meta.num_elements() > 0 && map.upsample.columns() > 0
}

impl FusionBackend for CubeBackend {
    fn fusion_layer(tensors: LayerTensors<Self>, map: Arc<LayerMap>) -> FloatTensor<Self> {
        if !on_device(&tensors, &map) {
            return on_host::fusion_layer::<Self>(tensors, &map);
        }
        let LayerTensors { x, weight, below, bias } = tensors;
        let gpu = Gpu::of(&bias);
        let (rows, width) = (map.upsample.rows(), bias.meta.num_elements());
        let out = gpu.floats([rows, width]);
        let with_product = weight.meta.num_elements() > 0;
        let product = match with_product {
            true => into_contiguous(Self::float_matmul(gathered(&gpu, &x, &map), weight)),
            false => gpu.floats([1]),
        };
        let upsample = DeviceMatrix::by_rows(&gpu, &map.upsample);
        let [offsets, indices, values] = upsample.args();
        add_and_bend::launch(
            &gpu.client,
            gpu.cubes_for(rows * width),
            gpu.dim(),
            arg(&product),
            offsets,
            indices,
            values,
            arg(&into_contiguous(below)),
            arg(&into_contiguous(bias)),
            arg(&out),
            (rows * width) as u32,
            width as u32,
            map.slope as f32,
            with_product,
        );
        out
    }

    fn fusion_layer_adjoint(
        tensors: LayerTensors<Self>,
        out: FloatTensor<Self>,
        g: FloatTensor<Self>,
        map: Arc<LayerMap>,
        wants_x: bool,
    ) -> LayerTensors<Self> {
        if !on_device(&tensors, &map) {
            return on_host::fusion_layer_adjoint::<Self>(tensors, out, g, &map, wants_x);
        }
        let LayerTensors { x, weight, bias, .. } = tensors;
        let gpu = Gpu::of(&bias);
        let (count, width) = (out.meta.num_elements(), bias.meta.num_elements());
        let mut g = g;
        if map.slope != 1.0 {
            g = own(g);
            let (cubes, slope) = (gpu.cubes_for(count), map.slope as f32);
            unbend::launch(&gpu.client, cubes, gpu.dim(), arg(&out), arg(&g), count as u32, slope);
        }
        let g = into_contiguous(g);
        let [x_rows, inputs] = x.meta.shape().dims();
        let nothing =
            |rows: usize| Self::float_zeros([rows, inputs].into(), gpu.device(), burn::tensor::FloatDType::F32);
        let d_weight = match inputs {
            0 => weight.clone(),
            _ => Self::float_matmul(Self::float_transpose(gathered(&gpu, &x, &map)), g.clone()),
        };
        let d_x = match wants_x && inputs > 0 {
            false => nothing(if wants_x { x_rows } else { 0 }),
            true => {
                let d = into_contiguous(Self::float_matmul(g.clone(), Self::float_transpose(weight)));
                match &map.rows {
                    None => d,
                    Some(rows) => {
                        let (whole, index, count) =
                            (into_contiguous(nothing(x_rows)), gpu.upload(rows, DType::U32), rows.len() * inputs);
                        let cubes = gpu.cubes_for(count);
                        let (count, width) = (count as u32, inputs as u32);
                        scatter::launch(&gpu.client, cubes, gpu.dim(), arg(&d), arg(&index), arg(&whole), count, width);
                        whole
                    }
                }
            }
        };
        let bias = Self::float_reshape(Self::float_sum_dim(g.clone(), 0), [width].into());
        let below = DeviceMatrix::by_columns(&gpu, &map.upsample).apply(&gpu, g);
        LayerTensors { x: d_x, weight: d_weight, below, bias }
    }
}
