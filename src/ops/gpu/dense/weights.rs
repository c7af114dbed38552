//! The gradient of the weights, a sum over all rows: cubes take a range of rows each, and what they find is added in a fixed order.

use super::zeros;
use crate::backend::gpu::{Gpu, UNITS, arg};
use burn::backend::ops::FloatTensorOps;
use burn::tensor::FloatDType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// Units along either side of a cube's square.
const SIDE: usize = 16;
/// Rows of a tile of the result that a unit keeps in registers, and most of its columns.
const OWN: usize = 4;
/// Rows of a tile.
const TILE: usize = SIDE * OWN;
/// Rows of both matrices that are in shared memory at a time.
const DEPTH: usize = SIDE;

/// Of `[rows, inputs]` and `[rows, width]`.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
struct Sizes {
    rows: u32,
    inputs: u32,
    width: u32,
}

/// `tensor` in order; a binding cannot be empty.
fn whole(gpu: &Gpu, tensor: &CubeTensor) -> CubeTensor {
    if tensor.meta.num_elements() == 0 {
        gpu.floats([1])
    } else {
        into_contiguous(tensor.clone())
    }
}

/// Columns of a tile that a unit keeps, of a result `width` wide.
fn each(width: usize) -> usize {
    width.div_ceil(SIDE).next_power_of_two().min(OWN)
}

/// Fewest rows whose share of the gradient is summed by one cube.
const LEAST_ROWS: usize = 256;
/// Cubes that should fill a device: chosen by counting, not by a measurement.
const CUBES: usize = 512;
/// Values of the sum of all parts that a cube makes, each by `GROUPS` units.
const LANES: usize = 32;
const GROUPS: usize = UNITS as usize / LANES;

/// Of every `per_part` rows r the sum of `x[rows[r], i] g[r, o]`, and below it, where asked for, that of `g[r, o]`.
#[cube(launch)]
fn weights_parts(
    x: &[f32],
    rows: &[u32],
    g: &[f32],
    parts: &mut [f32],
    sizes: Sizes,
    per_part: u32,
    #[comptime] each: usize,
    #[comptime] gathered: bool,
    #[comptime] with_bias: bool,
) {
    let columns = comptime![SIDE * each];
    let (count, inputs, width) = (
        sizes.rows as usize,
        sizes.inputs as usize,
        sizes.width as usize,
    );
    let across = width.div_ceil(columns);
    let tiles = across * max(inputs.div_ceil(TILE), 1usize);
    let part = CUBE_POS / tiles;
    let first_row = part * per_part as usize;
    if first_row >= count {
        terminate!();
    }
    let end = min(first_row + per_part as usize, count);
    let first_input = CUBE_POS % tiles / across * TILE;
    let first_column = CUBE_POS % tiles % across * columns;
    let unit = UNIT_POS as usize;
    let (ux, uy) = (unit % SIDE, unit / SIDE);
    let mut left = Shared::<[f32]>::new_slice(DEPTH * TILE);
    let mut right = Shared::<[f32]>::new_slice(DEPTH * columns);
    let mut sums = Array::<f32>::new(OWN * each);
    #[unroll]
    for k in 0..OWN * each {
        sums[k] = 0.0f32;
    }
    let mut plain = Array::<f32>::new(each);
    #[unroll]
    for j in 0..each {
        plain[j] = 0.0f32;
    }
    for step in 0..(end - first_row).div_ceil(DEPTH) {
        let at_row = first_row + step * DEPTH;
        #[unroll]
        for i in 0..OWN {
            let at = unit + i * UNITS as usize;
            let (row, input) = (at_row + at / TILE, first_input + at % TILE);
            let mut value = 0.0f32;
            if row < end && input < inputs {
                let mut source = row;
                if comptime![gathered] {
                    source = rows[row] as usize;
                }
                value = x[source * inputs + input];
            }
            left[at] = value;
        }
        #[unroll]
        for j in 0..each {
            let at = unit + j * UNITS as usize;
            let (row, column) = (at_row + at / columns, first_column + at % columns);
            let mut value = 0.0f32;
            if row < end && column < width {
                value = g[row * width + column];
            }
            right[at] = value;
        }
        sync_cube();
        #[unroll]
        for depth in 0..DEPTH {
            let mut b = Array::<f32>::new(each);
            #[unroll]
            for j in 0..each {
                b[j] = right[depth * columns + ux + j * SIDE];
            }
            #[unroll]
            for i in 0..OWN {
                let a = left[depth * TILE + uy + i * SIDE];
                #[unroll]
                for j in 0..each {
                    sums[i * each + j] += a * b[j];
                }
            }
            if comptime![with_bias] && first_input == 0 && uy == 0 {
                #[unroll]
                for j in 0..each {
                    plain[j] += b[j];
                }
            }
        }
        sync_cube();
    }
    let mut below = inputs;
    if comptime![with_bias] {
        below += 1;
    }
    let start = part * below * width;
    #[unroll]
    for j in 0..each {
        let column = first_column + ux + j * SIDE;
        if column < width {
            #[unroll]
            for i in 0..OWN {
                let input = first_input + uy + i * SIDE;
                if input < inputs {
                    parts[start + input * width + column] = sums[i * each + j];
                }
            }
            if comptime![with_bias] && first_input == 0 && uy == 0 {
                parts[start + inputs * width + column] = plain[j];
            }
        }
    }
}

/// The sum of `parts`, each of which holds `weight_len` values of the weight's gradient and then those of the bias's, `len`
/// together.
#[cube(launch)]
fn add_parts(
    parts: &[f32],
    weight: &mut [f32],
    bias: &mut [f32],
    count: u32,
    weight_len: u32,
    len: u32,
) {
    let unit = UNIT_POS as usize;
    let at = CUBE_POS * LANES + unit % LANES;
    if CUBE_POS * LANES >= len as usize {
        terminate!();
    }
    let mut sums = Shared::<[f32]>::new_slice(UNITS as usize);
    let mut sum = 0.0f32;
    if at < len as usize {
        let mut part = unit / LANES;
        while part < count as usize {
            sum += parts[part * len as usize + at];
            part += GROUPS;
        }
    }
    sums[unit] = sum;
    sync_cube();
    if unit < LANES && at < len as usize {
        let mut total = 0.0f32;
        for group in 0..GROUPS {
            total += sums[group * LANES + unit];
        }
        if at < weight_len as usize {
            weight[at] = total;
        } else {
            bias[at - weight_len as usize] = total;
        }
    }
}

/// `x[rows]^T g` `[K, D]`, and the sum of the rows of `g`, `[D]`, where there is a bias; else nothing that means
/// anything. `x` is `[.., K]`, `g` `[R, D]`.
pub fn weights_gradient(
    gpu: &Gpu,
    x: &CubeTensor,
    rows: Option<&CubeTensor>,
    g: &CubeTensor,
    with_bias: bool,
) -> (CubeTensor, CubeTensor) {
    let ([count, width], inputs) = (g.meta.shape().dims(), x.meta.shape()[1]);
    let length = (inputs + usize::from(with_bias)) * width;
    if count * length == 0 {
        return (
            zeros(gpu, [inputs, width]),
            CubeBackend::float_zeros([width].into(), gpu.device(), FloatDType::F32),
        );
    }
    let tiles = inputs.div_ceil(TILE).max(1) * width.div_ceil(SIDE * each(width));
    let per_part = count
        .div_ceil(CUBES.div_ceil(tiles))
        .max(LEAST_ROWS)
        .next_multiple_of(DEPTH);
    let count_parts = count.div_ceil(per_part);
    let parts = gpu.floats([count_parts * length]);
    weights_parts::launch(
        &gpu.client,
        gpu.cubes(tiles * count_parts),
        gpu.dim(),
        arg(&whole(gpu, x)),
        arg(rows.unwrap_or(&gpu.words(1))),
        arg(&whole(gpu, g)),
        arg(&parts),
        SizesLaunch::new(count as u32, inputs as u32, width as u32),
        per_part as u32,
        each(width),
        rows.is_some(),
        with_bias,
    );
    let (weight, bias) = (gpu.floats([inputs, width]), gpu.floats([width]));
    add_parts::launch(
        &gpu.client,
        gpu.cubes(length.div_ceil(LANES)),
        gpu.dim(),
        arg(&parts),
        arg(&weight),
        arg(&bias),
        count_parts as u32,
        (inputs * width) as u32,
        length as u32,
    );
    (
        if inputs > 0 {
            weight
        } else {
            zeros(gpu, [0, width])
        },
        bias,
    )
}
