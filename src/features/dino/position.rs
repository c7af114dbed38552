//! Position embeddings for any number of patches.

use rayon::prelude::*;

/// Learned vectors: one for the class token, one for each cell of a square grid of patches.
#[derive(Clone, Debug)]
pub(super) struct PositionEmbedding {
    /// Cells along a side.
    pub side: usize,
    /// `[1 + side * side, width]`.
    pub values: Vec<f32>,
}

/// Added to the number of patches before the scale is computed, as the official code does lest rounding lose
/// a patch. The interpolated grid is therefore a little narrower than the image, which the weights' users all live with.
const MARGIN: f64 = 0.1;

/// Parameter of the cubic kernel (Keys 1981), PyTorch's choice.
const A: f64 = -0.75;

impl PositionEmbedding {
    /// The embeddings of the class token and `rows` x `columns` patches, `[1 + rows * columns, d]`; interpolated with
    /// bicubic kernels unless the patches are those of the grid.
    pub fn over(&self, rows: usize, columns: usize, d: usize) -> Vec<f32> {
        if (rows, columns) == (self.side, self.side) {
            return self.values.clone();
        }
        let (class, grid) = self.values.split_at(d);
        let (down, across) = (taps(self.side, rows), taps(self.side, columns));
        let mut out = vec![0.0; (1 + rows * columns) * d];
        out[..d].copy_from_slice(class);
        out[d..]
            .par_chunks_mut(columns * d)
            .zip(down)
            .for_each(|(line, down)| {
                for (cell, across) in line.chunks_exact_mut(d).zip(&across) {
                    for (y, weight_y) in down {
                        for (x, weight_x) in across {
                            let weight = (weight_y * weight_x) as f32;
                            let from = &grid[(y * self.side + x) * d..][..d];
                            cell.iter_mut()
                                .zip(from)
                                .for_each(|(o, v)| *o += weight * v);
                        }
                    }
                }
            });
        out
    }
}

/// For each of `to` places the four cells of `from` that it is interpolated between, and their weights. Beyond
/// the grid its border cells go on.
fn taps(from: usize, to: usize) -> Vec<[(usize, f64); 4]> {
    let step = from as f64 / (to as f64 + MARGIN);
    let last = from as f64 - 1.0;
    (0..to)
        .map(|i| {
            let at = step * (i as f64 + 0.5) - 0.5;
            let (first, t) = (at.floor(), at - at.floor());
            let weights = [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)];
            std::array::from_fn(|k| {
                (
                    (first + k as f64 - 1.0).clamp(0.0, last) as usize,
                    weights[k],
                )
            })
        })
        .collect()
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
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_a_ramp_stays_a_ramp_inside() {
        for (from, to) in [(14, 12), (14, 16), (28, 60), (14, 1), (1, 5), (2, 3)] {
            for (i, taps) in taps(from, to).iter().enumerate() {
                let sum: f64 = taps.iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() < 1e-12, "{from} {to}: {sum}");
                let at = from as f64 / (to as f64 + MARGIN) * (i as f64 + 0.5) - 0.5;
                if at >= 1.0 && at < from as f64 - 2.0 && to >= from {
                    let read: f64 = taps.iter().map(|t| t.0 as f64 * t.1).sum();
                    // Keys' kernels with A other than -0.5 bend a ramp a little.
                    assert!((read - at).abs() < 0.05, "{from} {to} {i}: {read} at {at}");
                }
            }
        }
    }
}
