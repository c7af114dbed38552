//! A layer of the decoder on a device: one pass forward, which reads the rows that it needs where they are.

use super::dense::{Below, Product, binds_a_product, inputs_gradient, weights_gradient, zeros};
use super::sparse::DeviceMatrix;
use super::{covers, own};
use crate::gpu::{Gpu, arg};
use crate::ops::fusion_layer::{FusionBackend, LayerMap, LayerTensors, on_host};
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use std::sync::Arc;

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
    let bias = &tensors.bias;
    covers(bias)
        && binds_a_product(bias)
        && map.upsample.rows() * bias.meta.num_elements() > 0
        && map.upsample.columns() > 0
}

/// Which rows of `x` are read, where not all are.
fn rows(gpu: &Gpu, map: &LayerMap) -> Option<CubeTensor> {
    map.rows.as_ref().map(|rows| rows.on(gpu))
}

impl FusionBackend for CubeBackend {
    fn fusion_layer(tensors: LayerTensors<Self>, map: Arc<LayerMap>) -> FloatTensor<Self> {
        if !on_device(&tensors, &map) {
            return on_host::fusion_layer::<Self>(tensors, &map);
        }
        let LayerTensors { x, weight, below, bias } = tensors;
        let gpu = Gpu::of(&bias);
        let upsample = DeviceMatrix::by_rows(&gpu, &map.upsample).args();
        let below = Some(Below { upsample, y: &below, slope: map.slope as f32 });
        let rows = rows(&gpu, &map);
        let product = Product { x: &x, rows: rows.as_ref(), weight: &weight, bias: Some(&bias), below };
        product.run(&gpu, map.upsample.rows())
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
            unbend::launch(&gpu.client, cubes, gpu.dim(), arg(&out), arg(&g), count as u32, slope);
        }
        let g = into_contiguous(g);
        let rows = rows(&gpu, &map);
        let [x_rows, inputs] = x.meta.shape().dims();
        let (d_weight, d_bias) = weights_gradient(&gpu, &x, rows.as_ref(), &g, true);
        let d_x = match wants_x && inputs > 0 {
            true => inputs_gradient(&gpu, &g, &weight, rows.as_ref().map(|rows| (rows, x_rows))),
            false => zeros(&gpu, [if wants_x { x_rows } else { 0 }, inputs]),
        };
        let below = DeviceMatrix::by_columns(&gpu, &map.upsample).apply(&gpu, g);
        LayerTensors { x: d_x, weight: d_weight, below, bias: d_bias }
    }
}
