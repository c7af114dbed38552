//! `x[rows] W` with what a layer adds to it, and the gradient of `x`.

use super::{DEPTH, OWN, SIDE, Sizes, SizesLaunch, TILE, each, whole, zeros};
use crate::gpu::{Gpu, UNITS, arg};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// What a product does besides, for the compiler of the kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Plan {
    /// Columns of a tile that a unit keeps.
    each: usize,
    /// Row r of x is `rows[r]`.
    gathered: bool,
    /// Row r of the result is written to `rows[r]`.
    scattered: bool,
    /// The weight lies as `[width, inputs]`.
    transposed: bool,
    with_bias: bool,
    /// Adds what comes up from below, and bends.
    with_below: bool,
}

/// `x[rows] W`, and what `plan` says.
#[cube(launch)]
fn multiply_rows(
    x: &[f32],
    rows: &[u32],
    weight: &[f32],
    bias: &[f32],
    offsets: &[u32],
    indices: &[u32],
    values: &[f32],
    below: &[f32],
    out: &mut [f32],
    sizes: Sizes,
    slope: f32,
    #[comptime] plan: Plan,
) {
    let each = comptime![plan.each];
    let columns = comptime![SIDE * plan.each];
    let (count, inputs, width) = (sizes.rows as usize, sizes.inputs as usize, sizes.width as usize);
    let across = width.div_ceil(columns);
    let first_row = CUBE_POS / across * TILE;
    let first_column = CUBE_POS % across * columns;
    if first_row >= count {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let (ux, uy) = (unit % SIDE, unit / SIDE);
    // One more a row: units side by side store to different banks.
    let mut left = Shared::<[f32]>::new_slice(TILE * (DEPTH + 1));
    let mut right = Shared::<[f32]>::new_slice(DEPTH * (columns + 1));
    let mut sums = Array::<f32>::new(OWN * each);
    #[unroll]
    for k in 0..OWN * each {
        sums[k] = 0.0f32;
    }
    let mut starts = Array::<u32>::new(OWN);
    #[unroll]
    for i in 0..OWN {
        let row = first_row + uy + i * SIDE;
        let mut source = row as u32;
        if comptime![plan.gathered] {
            source = 0u32;
            if row < count {
                source = rows[row];
            }
        }
        starts[i] = source * sizes.inputs;
    }
    for step in 0..inputs.div_ceil(DEPTH) {
        let k = step * DEPTH + ux;
        #[unroll]
        for i in 0..OWN {
            let mut value = 0.0f32;
            if first_row + uy + i * SIDE < count && k < inputs {
                value = x[starts[i] as usize + k];
            }
            left[(uy + i * SIDE) * (DEPTH + 1) + ux] = value;
        }
        #[unroll]
        for i in 0..each {
            let at = unit + i * UNITS as usize;
            let mut depth = at / columns;
            let mut column = at % columns;
            if comptime![plan.transposed] {
                depth = at % DEPTH;
                column = at / DEPTH;
            }
            let (k, c) = (step * DEPTH + depth, first_column + column);
            let mut value = 0.0f32;
            if k < inputs && c < width {
                value = if comptime![plan.transposed] { weight[c * inputs + k] } else { weight[k * width + c] };
            }
            right[depth * (columns + 1) + column] = value;
        }
        sync_cube();
        #[unroll]
        for depth in 0..DEPTH {
            let mut b = Array::<f32>::new(each);
            #[unroll]
            for j in 0..each {
                b[j] = right[depth * (columns + 1) + ux + j * SIDE];
            }
            #[unroll]
            for i in 0..OWN {
                let a = left[(uy + i * SIDE) * (DEPTH + 1) + depth];
                #[unroll]
                for j in 0..each {
                    sums[i * each + j] += a * b[j];
                }
            }
        }
        sync_cube();
    }
    #[unroll]
    for i in 0..OWN {
        let row = first_row + uy + i * SIDE;
        if row < count {
            if comptime![plan.with_below] {
                for at in offsets[row]..offsets[row + 1] {
                    let source = indices[at as usize] as usize * width + first_column + ux;
                    #[unroll]
                    for j in 0..each {
                        if first_column + ux + j * SIDE < width {
                            sums[i * each + j] += values[at as usize] * below[source + j * SIDE];
                        }
                    }
                }
            }
            let mut target = row;
            if comptime![plan.scattered] {
                target = rows[row] as usize;
            }
            #[unroll]
            for j in 0..each {
                let column = first_column + ux + j * SIDE;
                if column < width {
                    let mut sum = sums[i * each + j];
                    if comptime![plan.with_bias] {
                        sum += bias[column];
                    }
                    if comptime![plan.with_below] && sum <= 0.0f32 {
                        sum *= slope;
                    }
                    out[target * width + column] = sum;
                }
            }
        }
    }
}

/// What a layer adds to its product: the map from below as the arrays of a sparse matrix, `y`, and the slope.
pub struct Below<'a> {
    pub upsample: [BufferArg; 3],
    pub y: &'a CubeTensor,
    pub slope: f32,
}

/// A product of rows, see [`multiply_rows`].
pub struct Product<'a> {
    /// `[.., K]`.
    pub x: &'a CubeTensor,
    /// The row of `x` for each row of the result; absent: all of them.
    pub rows: Option<&'a CubeTensor>,
    /// `[K, D]`.
    pub weight: &'a CubeTensor,
    /// `[D]`.
    pub bias: Option<&'a CubeTensor>,
    pub below: Option<Below<'a>>,
}

impl Product<'_> {
    /// `x[rows] W + b`, and what comes up from below: `[count, D]`, of which neither is 0.
    pub fn run(self, gpu: &Gpu, count: usize) -> CubeTensor {
        let [inputs, width] = self.weight.meta.shape().dims();
        let plan = Plan {
            each: each(width),
            gathered: self.rows.is_some(),
            with_bias: self.bias.is_some(),
            with_below: self.below.is_some(),
            ..Plan::default()
        };
        let out = gpu.floats([count, width]);
        self.launch(gpu, &out, [count, inputs, width], plan);
        out
    }

    fn launch(self, gpu: &Gpu, out: &CubeTensor, [count, inputs, width]: [usize; 3], plan: Plan) {
        // Bound where there is nothing to read.
        let (words, floats) = (gpu.words(1), gpu.floats([1]));
        let bias = self.bias.map_or_else(|| floats.clone(), |bias| whole(gpu, bias));
        let (upsample, y, slope) = match self.below {
            Some(below) => (below.upsample, whole(gpu, below.y), below.slope),
            None => ([arg(&words), arg(&words), arg(&floats)], floats, 1.0),
        };
        let [offsets, indices, values] = upsample;
        let cubes = count.div_ceil(TILE) * width.div_ceil(SIDE * plan.each);
        multiply_rows::launch(
            &gpu.client,
            gpu.cubes(cubes),
            gpu.dim(),
            arg(&whole(gpu, self.x)),
            arg(self.rows.unwrap_or(&words)),
            arg(&whole(gpu, self.weight)),
            arg(&bias),
            offsets,
            indices,
            values,
            arg(&y),
            arg(out),
            SizesLaunch::new(count as u32, inputs as u32, width as u32),
            slope,
            plan,
        );
    }
}

/// `g W^T`, `[count, K]`, of which neither is 0: row r is row `rows[r]` of the result, which has `total` rows then and zeros in
/// those that are not named. `g` is `[count, D]`, `weight` `[K, D]`.
pub fn inputs_gradient(
    gpu: &Gpu,
    g: &CubeTensor,
    weight: &CubeTensor,
    rows: Option<(&CubeTensor, usize)>,
) -> CubeTensor {
    let [inputs, width] = weight.meta.shape().dims();
    let count = g.meta.shape()[0];
    let plan = Plan { each: each(inputs), scattered: rows.is_some(), transposed: true, ..Plan::default() };
    let (rows, out) = match rows {
        Some((rows, total)) => (Some(rows), into_contiguous(zeros(gpu, [total, inputs]))),
        None => (None, gpu.floats([count, inputs])),
    };
    let product = Product { x: g, rows, weight, bias: None, below: None };
    product.launch(gpu, &out, [count, width, inputs], plan);
    out
}
