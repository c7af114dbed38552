//! A layer of the decoder on a device: rows gathered, one product, and the rest in one pass.

use super::dense::{weights_gradient, zeros};
use super::sparse::DeviceMatrix;
use super::{covers, own};
use crate::backend::gpu::{Gpu, arg};
use crate::ops::fusion_layer::{FusionBackend, LayerMap, LayerTensors, on_host};
use crate::ops::gather::GatherBackend;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

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

/// Whether kernels take this layer: something comes out.
fn on_device(tensors: &LayerTensors<CubeBackend>, map: &LayerMap) -> bool {
    covers(&tensors.bias)
        && map.upsample.rows() * tensors.bias.meta.num_elements() > 0
        && map.upsample.columns() > 0
}

/// `x[rows]`, or `x` where all rows are read.
fn gathered(x: CubeTensor, map: &LayerMap) -> CubeTensor {
    match &map.rows {
        Some(rows) => CubeBackend::gather_rows(x, rows.clone()),
        None => x,
    }
}

impl FusionBackend for CubeBackend {
    fn fusion_layer(tensors: LayerTensors<Self>, map: Arc<LayerMap>) -> FloatTensor<Self> {
        if !on_device(&tensors, &map) {
            return on_host::fusion_layer::<Self>(tensors, &map);
        }
        let LayerTensors {
            x,
            weight,
            below,
            bias,
        } = tensors;
        let gpu = Gpu::of(&bias);
        let (rows, width) = (map.upsample.rows(), bias.meta.num_elements());
        let out = gpu.floats([rows, width]);
        let with_product = weight.meta.num_elements() > 0;
        let product = match with_product {
            true => into_contiguous(Self::float_matmul(gathered(x, &map), weight)),
            false => gpu.floats([1]),
        };
        let [offsets, indices, values] = DeviceMatrix::by_rows(&gpu, &map.upsample).args();
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
        let LayerTensors { x, weight, .. } = tensors;
        let gpu = Gpu::of(&out);
        let count = out.meta.num_elements();
        let mut g = g;
        if map.slope != 1.0 {
            g = own(g);
            let (cubes, slope) = (gpu.cubes_for(count), map.slope as f32);
            unbend::launch(
                &gpu.client,
                cubes,
                gpu.dim(),
                arg(&out),
                arg(&g),
                count as u32,
                slope,
            );
        }
        let g = into_contiguous(g);
        let rows = map.rows.as_ref().map(|rows| rows.on(&gpu));
        let [x_rows, inputs] = x.meta.shape().dims();
        let (d_weight, d_bias) = weights_gradient(&gpu, &x, rows.as_ref(), &g, true);
        let d_x = match wants_x && inputs > 0 {
            false => zeros(&gpu, [if wants_x { x_rows } else { 0 }, inputs]),
            true => {
                let d =
                    into_contiguous(Self::float_matmul(g.clone(), Self::float_transpose(weight)));
                match &map.rows {
                    None => d,
                    Some(rows) => Self::scatter_rows(d, rows.clone(), x_rows),
                }
            }
        };
        let below = DeviceMatrix::by_columns(&gpu, &map.upsample).apply(&gpu, g);
        LayerTensors {
            x: d_x,
            weight: d_weight,
            below,
            bias: d_bias,
        }
    }
}
