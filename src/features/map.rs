//! Feature maps: grids of vectors.

use super::lattice::{Axis, Lattice, Steps};
use crate::backend::check_finite;
use crate::backend::device::read;
use crate::error::{Result, ensure};
use burn::tensor::Tensor;
use rayon::prelude::*;

/// A grid of feature vectors over an image; [`Lattice`] says where its cells are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureMap {
    /// Cells down.
    pub height: usize,
    /// Cells across.
    pub width: usize,
    /// Values per cell.
    pub channels: usize,
    /// Row-major `[height, width, channels]`.
    pub data: Vec<f32>,
    /// Where the cells are, when they do not divide the image evenly.
    pub steps: Option<Steps>,
}

impl FeatureMap {
    /// A map of zeros that divides its image evenly.
    pub fn zeros(height: usize, width: usize, channels: usize) -> Self {
        Self {
            height,
            width,
            channels,
            data: vec![0.0; height * width * channels],
            steps: None,
        }
    }

    /// The map of cells `[1, height, width, channels]`; `what` names it in errors.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] with the first cell that holds a NaN or an infinity; [`crate::Error::Device`] when the device
    /// fails.
    pub(super) fn from_tensor(cells: Tensor<4>, steps: Option<Steps>, what: &str) -> Result<Self> {
        let [_, height, width, channels] = cells.dims();
        let map = Self {
            height,
            width,
            channels,
            data: read(what, cells)?,
            steps,
        };
        map.check(what)?;
        Ok(map)
    }

    /// Where the cells are.
    pub fn lattice(&self) -> Lattice {
        Lattice {
            width: self.width,
            height: self.height,
            steps: self.steps,
        }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.height * self.width
    }

    /// The vector of cell `(x, y)`.
    pub fn cell(&self, x: usize, y: usize) -> &[f32] {
        &self.data[(y * self.width + x) * self.channels..][..self.channels]
    }

    /// The four cells and weights of the bilinear read at image point `(u, v)` of a `width` x `height` image.
    ///
    /// Beyond the outermost cell centres the border cell is read. The weights are not negative and sum to 1.
    pub fn taps(&self, u: f64, v: f64, width: usize, height: usize) -> [(usize, f32); 4] {
        let lattice = self.lattice();
        let (x0, x1, fx) = lattice.columns(width).taps(u);
        let (y0, y1, fy) = lattice.rows(height).taps(v);
        let at = |x: usize, y: usize| y * self.width + x;
        [
            (at(x0, y0), (1.0 - fx) * (1.0 - fy)),
            (at(x1, y0), fx * (1.0 - fy)),
            (at(x0, y1), (1.0 - fx) * fy),
            (at(x1, y1), fx * fy),
        ]
    }

    /// Adds the bilinear read at image point `(u, v)` of a `width` x `height` image to `out`, length `channels`.
    pub fn sample(&self, u: f64, v: f64, width: usize, height: usize, out: &mut [f32]) {
        mix(
            &self.data,
            self.channels,
            &self.taps(u, v, width, height),
            out,
        );
    }

    /// The map on another grid over the same image: area mean along an axis that shrinks, linear along one that grows.
    /// Both divide the image evenly.
    pub(crate) fn resized(&self, height: usize, width: usize) -> Self {
        let rows = self.mixed_rows(&axis_weights(self.height, height));
        if width == self.width {
            return rows;
        }
        rows.mixed_columns(&axis_weights(self.width, width))
    }

    /// A row for each of `taps`: the sum of the weighted rows that they name.
    pub(super) fn mixed_rows(&self, taps: &[Taps]) -> Self {
        let row = self.width * self.channels;
        let mut out = Self::zeros(taps.len(), self.width, self.channels);
        let rows = out.data.par_chunks_mut(row.max(1)).zip(taps);
        rows.for_each(|(out, taps)| mix(&self.data, row, taps, out));
        out
    }

    /// A column for each of `taps`: the sum of the weighted columns that they name.
    pub(super) fn mixed_columns(&self, taps: &[Taps]) -> Self {
        let c = self.channels;
        let mut out = Self::zeros(self.height, taps.len(), c);
        out.data
            .par_chunks_mut((taps.len() * c).max(1))
            .zip(self.data.par_chunks((self.width * c).max(1)))
            .for_each(|(out, row)| {
                for (out, taps) in out.chunks_exact_mut(c.max(1)).zip(taps) {
                    mix(row, c, taps, out);
                }
            });
        out
    }

    /// Checks that the sizes agree and every value is finite; `what` names the map in the error.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] with the first offending cell; [`crate::Error::Argument`] when the length is not `h * w * c`.
    pub fn check(&self, what: &str) -> Result<()> {
        let expected = self.height * self.width * self.channels;
        ensure!(self.data.len() == expected, argument "{what}"; found "{} values", self.data.len();
            expected  "{expected} = {} x {} x {}", self.height, self.width, self.channels;
            help "give height * width * channels values");
        check_finite(what, &self.data, self.channels)
    }
}

/// Cells along an axis, each with a weight.
pub(super) type Taps = Vec<(usize, f32)>;

/// Adds the weighted pieces of `values` that `taps` name to `out`; a piece has `length` values.
fn mix(values: &[f32], length: usize, taps: &[(usize, f32)], out: &mut [f32]) {
    for &(piece, weight) in taps {
        for (o, &x) in out.iter_mut().zip(&values[piece * length..][..length]) {
            *o += weight * x;
        }
    }
}

/// For each of `to` cells the source cells of `from` and their weights, which sum to 1.
fn axis_weights(from: usize, to: usize) -> Vec<Taps> {
    let step = from as f64 / to as f64;
    let area = |i: usize| {
        let (a, b) = (i as f64 * step, (i + 1) as f64 * step);
        let span = a as usize..(b.ceil() as usize).min(from);
        span.filter_map(|k| {
            let overlap = b.min((k + 1) as f64) - a.max(k as f64);
            (overlap > 1e-9).then_some((k, (overlap / step) as f32))
        })
        .collect()
    };
    let linear = |i: usize| {
        let (a, b, f) = Axis::even(from, to).taps(i as f64 + 0.5);
        vec![(a, 1.0 - f), (b, f)]
    };
    (0..to)
        .map(|i| if to <= from { area(i) } else { linear(i) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_a_ramp_stays_a_ramp() {
        for (from, to) in [
            (480, 120),
            (270, 68),
            (7, 7),
            (5, 2),
            (3, 11),
            (1, 4),
            (9, 1),
        ] {
            for taps in axis_weights(from, to) {
                let sum: f32 = taps.iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() < 1e-6, "{from} {to}: {sum}");
            }
        }
        let ramp = FeatureMap {
            height: 1,
            width: 40,
            channels: 1,
            data: (0..40).map(|x| x as f32 + 0.5).collect(),
            ..FeatureMap::default()
        };
        // A whole number of cells: cells are constant inside, so a cut one would not give the ramp back exactly.
        for (x, value) in ramp.resized(1, 8).data.iter().enumerate() {
            assert!((value - (x as f32 + 0.5) * 5.0).abs() < 1e-4);
        }
        let mut out = [0.0];
        ramp.sample(101.0, 0.3, 400, 3, &mut out);
        assert!((out[0] - 10.1).abs() < 1e-5);
    }
}
