//! Features over the neighbours of points: position codes, attentive means, random sampling.

use super::POSITION_CHANNELS;
use crate::backend::device::upload;
use crate::ops::select;
use crate::segmentation::sampling::SampledLevel;
use burn::tensor::{Device, Tensor};
use std::ops::Range;

/// The input of the local spatial encoding for the neighbours of the points in `range`, `[K R, 10]`: distance, p_i - p_k,
/// p_i, p_k.
pub(super) fn position_code(
    level: &SampledLevel,
    range: Range<usize>,
    device: &Device,
) -> Tensor<2> {
    let k = level.neighbours.k;
    let rows = range.len() * k;
    let mut code = Vec::with_capacity(rows * POSITION_CHANNELS);
    for slot in 0..k {
        for i in range.clone() {
            let p = level.positions[i];
            let q = level.positions[level.neighbours.row(i)[slot] as usize];
            let d = [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
            let distance = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            code.extend_from_slice(&[
                distance, d[0], d[1], d[2], p[0], p[1], p[2], q[0], q[1], q[2],
            ]);
        }
    }
    upload(code, [rows, POSITION_CHANNELS], device)
}

/// Rows of `features` for the neighbours of `points`: `[K R, d]`.
pub(super) fn gather(
    features: &Tensor<2>,
    level: &SampledLevel,
    points: impl Iterator<Item = usize> + Clone,
) -> Tensor<2> {
    let neighbours = &level.neighbours;
    let slots = (0..neighbours.k).flat_map(|slot| points.clone().map(move |i| (slot, i)));
    let rows: Vec<u32> = slots.map(|(slot, i)| neighbours.row(i)[slot]).collect();
    select(features, &rows)
}

/// `[R, C]` from `x` and `scores` `[K R, C]`: for each channel the mean over K neighbours by the softmax of their scores.
pub(super) fn attentive_mean(x: Tensor<2>, scores: Tensor<2>, k: usize) -> Tensor<2> {
    let [rows, channels] = x.dims();
    let shape = [k, rows / k, channels];
    let scores = scores.reshape(shape);
    // The shift is a constant that cancels.
    let weights = (scores.clone() - over_neighbours(scores.detach())).exp();
    let sum = (x.reshape(shape) * weights.clone()).sum_dim(0);
    (sum / weights.sum_dim(0)).reshape([rows / k, channels])
}

/// The largest value over the first dimension, `[1, R, d]`.
fn over_neighbours(x: Tensor<3>) -> Tensor<3> {
    let k = x.dims()[0];
    let slots = x.clone().chunk(k, 0).into_iter();
    slots.reduce(Tensor::max_pair).unwrap_or(x)
}

/// Random sampling: the kept points, `together` at a time, take the element-wise maximum over their neighbours' features.
pub(super) fn sample(features: &Tensor<2>, level: &SampledLevel, together: usize) -> Tensor<2> {
    let channels = features.dims()[1];
    let parts = level.kept.chunks(together).map(|kept| {
        let gathered = gather(features, level, kept.iter().map(|&i| i as usize));
        let shape = [level.neighbours.k, kept.len(), channels];
        over_neighbours(gathered.reshape(shape)).reshape([kept.len(), channels])
    });
    Tensor::cat(parts.collect(), 0)
}

#[cfg(all(test, feature = "ndarray"))]
mod tests {
    use super::*;
    use burn::tensor::{DType, TensorData};

    const SHAPE: [usize; 3] = [5, 6, 7];

    fn input(values: &[f64]) -> Tensor<2> {
        let device = crate::backend::device::open(None).unwrap().autodiff();
        let data = TensorData::new(values.to_vec(), [SHAPE[0] * SHAPE[1], SHAPE[2]]);
        Tensor::from_data(data, (&device, DType::F64)).require_grad()
    }

    fn wave(step: f64, amplitude: f64) -> Vec<f64> {
        let count = SHAPE.iter().product::<usize>();
        (0..count)
            .map(|i| (i as f64 * step).sin() * amplitude)
            .collect()
    }

    /// The sum of cubes of the means, by the definition of the softmax.
    fn direct(x: &[f64], scores: &[f64]) -> f64 {
        let columns = SHAPE[1] * SHAPE[2];
        let mean = |i: usize| {
            let of = |values: &[f64]| -> Vec<f64> {
                (0..SHAPE[0])
                    .map(|slot| values[slot * columns + i])
                    .collect()
            };
            let x = of(x);
            let scores = of(scores);
            let highest = scores.iter().copied().fold(f64::MIN, f64::max);
            let powers: Vec<f64> = scores.iter().map(|s| (s - highest).exp()).collect();
            let sum: f64 = powers.iter().zip(&x).map(|(p, x)| p * x).sum();
            sum / powers.iter().sum::<f64>()
        };
        (0..columns).map(|i| mean(i).powi(3)).sum()
    }

    #[test]
    fn attentive_mean_equals_its_definition_and_its_gradient_finite_differences() {
        for amplitude in [3.0, 9e3] {
            let x = wave(0.7, 3.0);
            let scores = wave(1.3, amplitude);
            let leaves = [input(&x), input(&scores)];
            let mean = attentive_mean(leaves[0].clone(), leaves[1].clone(), SHAPE[0]);
            let value = mean.powi_scalar(3).sum();
            let gradients = value.clone().backward();
            let value: f64 = value.into_scalar();
            let want = direct(&x, &scores);
            assert!((value - want).abs() < 1e-10 * want.abs());
            for (which, leaf) in leaves.iter().enumerate() {
                let gradient = leaf.grad(&gradients).unwrap().into_data();
                let gradient = gradient.into_vec::<f64>().unwrap();
                for (i, got) in gradient.iter().enumerate() {
                    let at = |by: f64| {
                        let mut moved = [x.clone(), scores.clone()];
                        moved[which][i] += by;
                        direct(&moved[0], &moved[1])
                    };
                    let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
                    assert!((got - numeric).abs() < 1e-5, "{got} for {numeric}");
                }
            }
        }
    }
}
