//! Position embeddings for any number of patches.

use crate::backend::device::upload;
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// Learned vectors: one for the class token, one for each cell of a square grid of patches.
#[derive(Module, Debug)]
pub(super) struct PositionEmbedding {
    /// Cells along a side.
    pub side: usize,
    /// `[1 + side * side, width]`.
    pub values: Param<Tensor<2>>,
}

/// Added to the number of patches before the scale is computed. The official code does this so that rounding does not lose a
/// patch. The interpolated grid is therefore a little narrower than the image.
const MARGIN: f64 = 0.1;

/// Parameter of the cubic kernel (Keys 1981), PyTorch's choice.
const A: f64 = -0.75;

impl PositionEmbedding {
    /// The embeddings of the class token and `rows` x `columns` patches, `[1 + rows * columns, width]`: interpolated with
    /// bicubic kernels unless the patches are those of the grid.
    pub fn over(&self, rows: usize, columns: usize) -> Tensor<2> {
        let side = self.side;
        let values = self.values.val();
        if (rows, columns) == (side, side) {
            return values;
        }
        let width = values.dims()[1];
        let device = values.device();
        let weights = |to: usize| upload(interpolation(side, to), [to, side], &device);
        let class = values.clone().narrow(0, 0, 1);
        let grid = values.narrow(0, 1, side * side);
        // [side, side * width] to [rows, side, width], then [side, rows * width] to [columns, rows, width].
        let down = weights(rows).matmul(grid.reshape([side, side * width]));
        let down = down.reshape([rows, side, width]).swap_dims(0, 1);
        let across = weights(columns).matmul(down.reshape([side, rows * width]));
        let across = across.reshape([columns, rows, width]).swap_dims(0, 1);
        Tensor::cat(vec![class, across.reshape([rows * columns, width])], 0)
    }
}

/// The matrix `[to, from]` that interpolates `from` cells at `to` places. Beyond the grid, border cells repeat.
fn interpolation(from: usize, to: usize) -> Vec<f32> {
    let step = from as f64 / (to as f64 + MARGIN);
    let last = from as f64 - 1.0;
    let mut weights = vec![0.0; to * from];
    for (i, row) in weights.chunks_exact_mut(from).enumerate() {
        let at = step * (i as f64 + 0.5) - 0.5;
        let t = at - at.floor();
        let taps = [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)];
        for (k, weight) in taps.into_iter().enumerate() {
            let cell = (at.floor() + k as f64 - 1.0).clamp(0.0, last);
            row[cell as usize] += weight as f32;
        }
    }
    weights
}

/// The cubic kernel within one cell.
fn near(x: f64) -> f64 {
    ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
}

/// The cubic kernel from one cell to two.
fn far(x: f64) -> f64 {
    ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A
}

#[cfg(test)]
mod position_tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_a_ramp_stays_a_ramp_inside() {
        for (from, to) in [(14, 12), (14, 16), (28, 60), (14, 1), (1, 5), (2, 3)] {
            for (i, row) in interpolation(from, to).chunks_exact(from).enumerate() {
                let sum: f32 = row.iter().sum();
                assert!((sum - 1.0).abs() < 1e-6, "{from} {to}: {sum}");
                let at = from as f64 / (to as f64 + MARGIN) * (i as f64 + 0.5) - 0.5;
                if at >= 1.0 && at < from as f64 - 2.0 && to >= from {
                    let read: f64 = (0..from)
                        .zip(row)
                        .map(|(k, &w)| k as f64 * f64::from(w))
                        .sum();
                    // Keys' kernels with A other than -0.5 bend a ramp a little.
                    assert!((read - at).abs() < 0.05, "{from} {to} {i}: {read} at {at}");
                }
            }
        }
    }
}
