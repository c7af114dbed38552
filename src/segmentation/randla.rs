//! RandLA-Net's encoder (Hu et al. 2020), as burn modules.
//!
//! Features are `[rows, channels]` throughout. A tensor over the `K` neighbours of `R` points has `K R` rows, first those of
//! the first neighbours: sums over neighbours then add long contiguous arrays. 1x1 convolutions are linear layers. Key names and wiring are those of the PyTorch port
//! whose checkpoints are published.

use super::sampling::{Hierarchy, SampledLevel};
use crate::backend::device::upload;
use crate::error::{Error, Result};
use crate::ops::select;
use crate::weights::{HostTensor, WeightFile};
use burn::module::{Module, Param, RunningState};
use burn::nn::{BatchNorm, BatchNormConfig, Linear};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use std::ops::Range;

/// Slope of LeakyReLU below zero.
const SLOPE: f64 = 0.2;
/// Epsilon of batch normalisation in the published port (PyTorch's default).
pub const NORM_EPSILON: f64 = 1e-5;
/// Share of a new batch in the running statistics while pretraining.
const NORM_MOMENTUM: f64 = 0.03;
/// Channels of the relative position code: distance, p_i - p_k, p_i, p_k.
pub const POSITION_CHANNELS: usize = 10;
/// Encoder layers; the decoder has as many upsamplings.
pub const LAYERS: usize = 4;
/// Neighbours a point, itself included.
pub const NEIGHBOURS: usize = 16;
/// Each sampling keeps one point in this many.
pub const RATIO: usize = 4;

/// Values that [`RandlaEncoder::encode_levels`] holds per tensor in one chunk of points, when it may chunk.
const CHUNK_VALUES: usize = 1 << 19;

/// LeakyReLU with slope 0.2, as a sum: the backward pass of burn's own selects by masks, twice.
pub(crate) fn leaky_relu(x: Tensor<2>) -> Tensor<2> {
    relu(x.clone()) * (1.0 - SLOPE) + x * SLOPE
}

/// Reads modules from a checkpoint, on a device.
struct Loader<'a> {
    weights: &'a WeightFile,
    device: &'a Device,
}

impl Loader<'_> {
    /// Linear weights `[out, in]` under `name`, as burn has them.
    fn matrix(&self, name: &str, [input, output]: [usize; 2]) -> Result<Param<Tensor<2>>> {
        let values = transposed(self.weights.get(name, &[output, input])?, input, output);
        Ok(parameter(values, [input, output], self.device))
    }

    fn vector(&self, name: &str, length: usize) -> Result<Tensor<1>> {
        let values = self.weights.get(name, &[length])?;
        Ok(upload(values.to_vec(), [length], self.device))
    }

    /// `NAME.conv.weight`, optional `NAME.conv.bias`, and `NAME.bn.bn.*`.
    fn mlp(&self, name: &str, [input, output]: [usize; 2]) -> Result<SharedMlp> {
        let weight = self.matrix(&format!("{name}.conv.weight"), [input, output])?;
        let statistic = |part: &str| self.vector(&format!("{name}.bn.bn.{part}"), output);
        let config = BatchNormConfig::new(output)
            .with_epsilon(NORM_EPSILON)
            .with_momentum(NORM_MOMENTUM);
        let mut norm = config.init(self.device);
        norm.gamma = Param::from_tensor(statistic("weight")?);
        norm.beta = Param::from_tensor(statistic("bias")?);
        let mut mean = statistic("running_mean")?;
        let bias = format!("{name}.conv.bias");
        if self.weights.tensors.contains_key(&bias) {
            // A bias before batch normalisation moves the mean alone.
            mean = mean - self.vector(&bias, output)?;
        }
        norm.running_mean = RunningState::new(mean);
        norm.running_var = RunningState::new(statistic("running_var")?);
        Ok(SharedMlp {
            linear: Linear { weight, bias: None },
            norm,
        })
    }

    fn pooling(&self, name: &str, shape: [usize; 2]) -> Result<AttentivePooling> {
        let weight = self.matrix(&format!("{name}.fc.weight"), [shape[0]; 2])?;
        Ok(AttentivePooling {
            score: Linear { weight, bias: None },
            mlp: self.mlp(&format!("{name}.mlp"), shape)?,
        })
    }

    fn block(&self, n: usize, [input, d]: [usize; 2]) -> Result<ResidualBlock> {
        let mlp = |part: &str, shape| self.mlp(&block_name(n, part), shape);
        let pooling = |part: &str, shape| self.pooling(&block_name(n, part), shape);
        Ok(ResidualBlock {
            narrow: mlp("mlp1", [input, d / 2])?,
            first_code: mlp("lfa.mlp1", [POSITION_CHANNELS, d / 2])?,
            first_pooling: pooling("lfa.att_pooling_1", [d, d / 2])?,
            second_code: mlp("lfa.mlp2", [d / 2, d / 2])?,
            second_pooling: pooling("lfa.att_pooling_2", [d, d])?,
            widen: mlp("mlp2", [d, 2 * d])?,
            shortcut: mlp("shortcut", [input, 2 * d])?,
            width: d,
        })
    }
}

/// Name of a part of block `n` in a checkpoint.
pub(super) fn block_name(n: usize, part: &str) -> String {
    format!("dilated_res_blocks.{n}.{part}")
}

/// A linear layer and batch normalisation.
#[derive(Module, Debug)]
pub struct SharedMlp {
    linear: Linear,
    norm: BatchNorm,
}

impl SharedMlp {
    /// `[rows, in]` to `[rows, out]`.
    fn linear(&self, x: Tensor<2>) -> Tensor<2> {
        self.norm.forward(self.linear.forward(x))
    }

    /// [`SharedMlp::linear`] and LeakyReLU.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        leaky_relu(self.linear(x))
    }

    fn save(&self, weights: &mut WeightFile, name: &str) {
        save_matrix(weights, &format!("{name}.conv.weight"), &self.linear);
        for (part, values) in [
            ("weight", self.norm.gamma.val()),
            ("bias", self.norm.beta.val()),
            ("running_mean", self.norm.running_mean.value_sync()),
            ("running_var", self.norm.running_var.value_sync()),
        ] {
            let shape = values.dims().to_vec();
            let values = host(values);
            weights.insert(
                &format!("{name}.bn.bn.{part}"),
                HostTensor { shape, values },
            );
        }
    }
}

fn save_matrix(weights: &mut WeightFile, name: &str, linear: &Linear) {
    let [input, output] = linear.weight.dims();
    let values = transposed(&host(linear.weight.val()), output, input);
    let shape = vec![output, input];
    weights.insert(name, HostTensor { shape, values });
}

/// Weighted sum over the neighbours of each point, weights learned per channel, then a shared MLP.
#[derive(Module, Debug)]
pub struct AttentivePooling {
    score: Linear,
    mlp: SharedMlp,
}

impl AttentivePooling {
    fn save(&self, weights: &mut WeightFile, name: &str) {
        save_matrix(weights, &format!("{name}.fc.weight"), &self.score);
        self.mlp.save(weights, &format!("{name}.mlp"));
    }

    /// `[R, out]` for the points in `range`, from `features` of all points and the position `code` of their neighbours: for
    /// each channel the mean over the K neighbours of a point, by the softmax of `x W` over them.
    fn over(
        &self,
        features: &Tensor<2>,
        code: &Tensor<2>,
        level: &SampledLevel,
        range: Range<usize>,
    ) -> Tensor<2> {
        let x = Tensor::cat(vec![gather(features, level, range), code.clone()], 1);
        let scores = self.score.forward(x.clone());
        self.mlp
            .forward(attentive_mean(x, scores, level.neighbours.k))
    }
}

/// Local feature aggregation with a residual connection: `[N, d_in]` to `[N, 2 d]`.
#[derive(Module, Debug)]
pub struct ResidualBlock {
    narrow: SharedMlp,
    first_code: SharedMlp,
    first_pooling: AttentivePooling,
    second_code: SharedMlp,
    second_pooling: AttentivePooling,
    widen: SharedMlp,
    shortcut: SharedMlp,
    width: usize,
}

impl ResidualBlock {
    fn save(&self, weights: &mut WeightFile, n: usize) {
        let name = |part: &str| block_name(n, part);
        self.narrow.save(weights, &name("mlp1"));
        self.first_code.save(weights, &name("lfa.mlp1"));
        self.first_pooling.save(weights, &name("lfa.att_pooling_1"));
        self.second_code.save(weights, &name("lfa.mlp2"));
        self.second_pooling
            .save(weights, &name("lfa.att_pooling_2"));
        self.widen.save(weights, &name("mlp2"));
        self.shortcut.save(weights, &name("shortcut"));
    }

    /// All points at once: what training differentiates.
    fn forward(&self, features: Tensor<2>, level: &SampledLevel) -> Tensor<2> {
        let all = 0..level.positions.len();
        let narrow = self.narrow.forward(features.clone());
        let code = self.code(level, all.clone(), &features.device());
        let pooled = self.first_pooling.over(&narrow, &code, level, all.clone());
        let code = self.second_code.forward(code);
        let pooled = self.second_pooling.over(&pooled, &code, level, all);
        leaky_relu(self.widen.linear(pooled) + self.shortcut.linear(features))
    }

    /// The same in chunks of points, side by side: memory for `[points, K, d]` tensors stays bounded.
    fn forward_chunked(&self, features: Tensor<2>, level: &SampledLevel) -> Tensor<2> {
        let (points, k, device) = (level.positions.len(), level.neighbours.k, features.device());
        let chunk = (CHUNK_VALUES / (k * self.width)).max(1);
        let chunks = |stage: &(dyn Fn(Range<usize>) -> Tensor<2> + Sync)| {
            let starts: Vec<usize> = (0..points).step_by(chunk).collect();
            let parts: Vec<Tensor<2>> = starts
                .into_par_iter()
                .map(|s| stage(s..(s + chunk).min(points)))
                .collect();
            Tensor::cat(parts, 0)
        };
        let narrow = self.narrow.forward(features.clone());
        let pooled = chunks(&|range| {
            let code = self.code(level, range.clone(), &device);
            self.first_pooling.over(&narrow, &code, level, range)
        });
        chunks(&|range| {
            let code = self.code(level, range.clone(), &device);
            let code = self.second_code.forward(code);
            let pooled = self
                .second_pooling
                .over(&pooled, &code, level, range.clone());
            let shortcut = self.shortcut.linear(features.clone().slice([range]));
            leaky_relu(self.widen.linear(pooled) + shortcut)
        })
    }

    /// Encoded relative positions of the neighbours of the points in `range`, `[K R, d / 2]`.
    fn code(&self, level: &SampledLevel, range: Range<usize>, device: &Device) -> Tensor<2> {
        self.first_code.forward(position_code(level, range, device))
    }
}

/// The encoder: a first shared MLP and four residual blocks with random sampling between them.
#[derive(Module, Debug)]
pub struct RandlaEncoder {
    stem: SharedMlp,
    blocks: Vec<ResidualBlock>,
    inputs: usize,
}

impl RandlaEncoder {
    /// Reads the encoder of a checkpoint; widths and inputs follow its tensors, layers past the fourth are unused.
    ///
    /// # Errors
    /// [`Error::Input`] naming the tensor that is missing, has another shape than its neighbours ask for, or is not
    /// finite.
    pub fn load(weights: &WeightFile, device: &Device) -> Result<Self> {
        let loader = Loader { weights, device };
        let [stem, inputs] = match weights.shape("fc0.conv.weight")? {
            [stem, inputs, ..] if matches!(inputs, 3 | 6) => [*stem, *inputs],
            other => {
                return Err(Error::input(
                    &weights.origin,
                    "fc0.conv.weight",
                    format!("shape {other:?}"),
                    "[width, 3] (xyz) or [width, 6] (xyz, rgb)",
                    "give an encoder whose inputs are positions, with or without colours",
                ));
            }
        };
        let mut blocks = Vec::with_capacity(LAYERS);
        let mut input = stem;
        for n in 0..LAYERS {
            let width = weights.shape(&block_name(n, "lfa.att_pooling_2.fc.weight"))?;
            let d = width.first().copied().unwrap_or_default();
            blocks.push(loader.block(n, [input, d])?);
            input = 2 * d;
        }
        Ok(Self {
            stem: loader.mlp("fc0", [inputs, stem])?,
            blocks,
            inputs,
        })
    }

    /// All weights under the names that [`RandlaEncoder::load`] reads.
    pub fn to_weight_file(&self, origin: &str) -> WeightFile {
        let mut weights = WeightFile {
            origin: origin.into(),
            ..WeightFile::default()
        };
        self.stem.save(&mut weights, "fc0");
        for (n, block) in self.blocks.iter().enumerate() {
            block.save(&mut weights, n);
        }
        weights
    }

    /// Channels of the input: 3 (xyz) or 6 (xyz, rgb in 0..1).
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Channels of the features of levels 1 to 4; the coarsest set has those of the last.
    pub fn widths(&self) -> Vec<usize> {
        self.blocks.iter().map(|b| 2 * b.width).collect()
    }

    /// Features of every level before its sampling, then those of the coarsest set (Eq. 6 with the sampling innermost).
    /// `input` is `[N, 3 or 6]` on the points of level 1. Whole levels at once, for training, or chunk by chunk
    /// (`chunked`), which holds less and uses all cores.
    pub fn encode_levels(
        &self,
        input: Tensor<2>,
        hierarchy: &Hierarchy,
        chunked: bool,
    ) -> (Vec<Tensor<2>>, Tensor<2>) {
        let mut features = self.stem.forward(input);
        let mut outputs = Vec::with_capacity(self.blocks.len());
        for (block, level) in self.blocks.iter().zip(&hierarchy.levels) {
            let (output, together) = if chunked {
                let together = CHUNK_VALUES / (level.neighbours.k * 2 * block.width);
                (block.forward_chunked(features, level), together)
            } else {
                (block.forward(features, level), level.kept.len())
            };
            features = sample(&output, level, together.max(1));
            outputs.push(output);
        }
        (outputs, features)
    }
}

/// The input of the local spatial encoding for the neighbours of the points in `range`, `[K R, 10]`: distance, p_i - p_k,
/// p_i, p_k.
fn position_code(level: &SampledLevel, range: Range<usize>, device: &Device) -> Tensor<2> {
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
fn gather(
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
fn attentive_mean(x: Tensor<2>, scores: Tensor<2>, k: usize) -> Tensor<2> {
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
fn sample(features: &Tensor<2>, level: &SampledLevel, together: usize) -> Tensor<2> {
    let channels = features.dims()[1];
    let parts = level.kept.chunks(together).map(|kept| {
        let gathered = gather(features, level, kept.iter().map(|&i| i as usize));
        let shape = [level.neighbours.k, kept.len(), channels];
        over_neighbours(gathered.reshape(shape)).reshape([kept.len(), channels])
    });
    Tensor::cat(parts.collect(), 0)
}

/// `[rows, columns]` from `[columns, rows]`, row-major.
fn transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..rows * columns)
        .map(|i| values[i % columns * rows + i / columns])
        .collect()
}

/// Variant-major values of a tensor, f32.
pub(crate) fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor
        .into_data()
        .convert::<f32>()
        .into_vec()
        .unwrap_or_default() // just converted: always f32
}

pub(crate) fn parameter<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Param<Tensor<D>> {
    Param::from_tensor(upload(values, shape, device))
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
            let (x, scores) = (of(x), of(scores));
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
            let (x, scores) = (wave(0.7, 3.0), wave(1.3, amplitude));
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
