//! RandLA-Net's encoder (Hu et al. 2020), as burn modules.
//!
//! Features are `[rows, channels]` throughout. A tensor over the `K` neighbours of `R` points has `K R` rows, first those of
//! the first neighbours: sums over neighbours then add long contiguous arrays. 1x1 convolutions are linear layers. Key names and wiring are those of the PyTorch port
//! whose checkpoints are published.

use super::pyramid::select;
use super::sampling::{Hierarchy, SampledLevel};
use crate::error::{Error, Result};
use crate::weights::{Checkpoint, HostTensor};
use burn::module::{Module, Param};
use burn::nn::{BatchNorm, BatchNormConfig, Linear};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
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

/// Linear layer, batch normalisation (unless folded into the former), LeakyReLU (unless `linear_only`).
#[derive(Module, Debug)]
pub struct SharedMlp {
    linear: Linear,
    norm: Option<BatchNorm>,
    linear_only: bool,
}

/// Whether batch normalisation is folded into the linear layers or kept as a layer that trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Inference: constant weights, running statistics folded in.
    Frozen,
    /// Pretraining: batch statistics on an autodiff device.
    Trainable,
}

impl SharedMlp {
    /// Reads `NAME.conv.weight` (`[out, in]`), optional `NAME.conv.bias`, and `NAME.bn.bn.*`.
    pub(crate) fn load(
        weights: &Checkpoint,
        name: &str,
        [input, output]: [usize; 2],
        linear_only: bool,
        form: Form,
        device: &Device,
    ) -> Result<Self> {
        let weight = weights.get(&format!("{name}.conv.weight"), &[output, input])?;
        let bias_name = format!("{name}.conv.bias");
        let bias = match weights.tensors.contains_key(&bias_name) {
            true => weights.get(&bias_name, &[output])?.to_vec(),
            false => vec![0.0; output],
        };
        let part = |part: &str| weights.get(&format!("{name}.bn.bn.{part}"), &[output]);
        let (gamma, beta) = (part("weight")?, part("bias")?);
        let (mean, variance) = (part("running_mean")?, part("running_var")?);
        let mut matrix = transposed(weight, input, output);
        if form == Form::Trainable {
            let norm = BatchNormConfig::new(output)
                .with_epsilon(NORM_EPSILON)
                .with_momentum(NORM_MOMENTUM);
            let mut norm = norm.init(device);
            norm.gamma = parameter(gamma.to_vec(), [output], device);
            norm.beta = parameter(beta.to_vec(), [output], device);
            let state =
                |v: &[f32]| burn::module::RunningState::new(tensor(v.to_vec(), [output], device));
            (norm.running_mean, norm.running_var) = (state(mean), state(variance));
            // the bias of a layer before batch normalisation has no effect, so none is trained
            let linear = Linear {
                weight: parameter(matrix, [input, output], device),
                bias: None,
            };
            return Ok(Self {
                linear,
                norm: Some(norm),
                linear_only,
            });
        }
        let scale: Vec<f64> = (0..output)
            .map(|c| f64::from(gamma[c]) / (f64::from(variance[c]).max(0.0) + NORM_EPSILON).sqrt())
            .collect();
        for row in matrix.chunks_exact_mut(output) {
            row.iter_mut()
                .zip(&scale)
                .for_each(|(w, s)| *w = (f64::from(*w) * s) as f32);
        }
        let shift =
            |c: usize| (f64::from(bias[c]) - f64::from(mean[c])) * scale[c] + f64::from(beta[c]);
        let bias = (0..output).map(|c| shift(c) as f32).collect();
        let linear = Linear {
            weight: parameter(matrix, [input, output], device),
            bias: Some(parameter(bias, [output], device)),
        };
        Ok(Self {
            linear,
            norm: None,
            linear_only,
        })
    }

    /// Writes what [`SharedMlp::load`] reads.
    fn save(&self, weights: &mut Checkpoint, name: &str) {
        let [input, output] = self.linear.weight.dims();
        let matrix = transposed(&host(self.linear.weight.val()), output, input);
        weights.insert(
            &format!("{name}.conv.weight"),
            HostTensor {
                shape: vec![output, input],
                values: matrix,
            },
        );
        let mut vector = |part: &str, values: Vec<f32>| {
            weights.insert(
                &format!("{name}.{part}"),
                HostTensor {
                    shape: vec![output],
                    values,
                },
            );
        };
        if let Some(bias) = &self.linear.bias {
            vector("conv.bias", host(bias.val()));
        }
        let folded = [
            vec![1.0; output],
            vec![0.0; output],
            vec![0.0; output],
            vec![1.0 - NORM_EPSILON as f32; output],
        ];
        let [gamma, beta, mean, variance] = match &self.norm {
            Some(norm) => [
                host(norm.gamma.val()),
                host(norm.beta.val()),
                host(norm.running_mean.value_sync()),
                host(norm.running_var.value_sync()),
            ],
            None => folded,
        };
        vector("bn.bn.weight", gamma);
        vector("bn.bn.bias", beta);
        vector("bn.bn.running_mean", mean);
        vector("bn.bn.running_var", variance);
    }

    /// `[rows, in]` to `[rows, out]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let x = self.linear.forward(x);
        let x = match &self.norm {
            Some(norm) => norm.forward(x),
            None => x,
        };
        if self.linear_only { x } else { leaky_relu(x) }
    }
}

/// Weighted sum over the neighbours of each point, weights learned per channel, then a shared MLP.
#[derive(Module, Debug)]
pub struct AttentivePooling {
    score: Linear,
    mlp: SharedMlp,
}

impl AttentivePooling {
    fn load(
        weights: &Checkpoint,
        name: &str,
        shape: [usize; 2],
        form: Form,
        device: &Device,
    ) -> Result<Self> {
        let [input, _] = shape;
        let score = weights.get(&format!("{name}.fc.weight"), &[input, input])?;
        let weight = parameter(transposed(score, input, input), [input, input], device);
        let mlp = SharedMlp::load(weights, &format!("{name}.mlp"), shape, false, form, device)?;
        Ok(Self {
            score: Linear { weight, bias: None },
            mlp,
        })
    }

    fn save(&self, weights: &mut Checkpoint, name: &str) {
        let shape = self.score.weight.dims();
        let values = transposed(&host(self.score.weight.val()), shape[1], shape[0]);
        weights.insert(
            &format!("{name}.fc.weight"),
            HostTensor {
                shape: shape.to_vec(),
                values,
            },
        );
        self.mlp.save(weights, &format!("{name}.mlp"));
    }

    /// `[R, out]` from `x` `[K R, in]`: for each channel the mean over the K neighbours of a point, by the softmax of
    /// `x W` over them.
    fn forward(&self, x: Tensor<2>, k: usize) -> Tensor<2> {
        let scores = self.score.forward(x.clone());
        self.mlp.forward(attentive_mean(x, scores, k))
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
    fn load(
        weights: &Checkpoint,
        n: usize,
        [input, d]: [usize; 2],
        form: Form,
        device: &Device,
    ) -> Result<Self> {
        let name = |part: &str| format!("dilated_res_blocks.{n}.{part}");
        let mlp = |part: &str, shape, linear_only| {
            SharedMlp::load(weights, &name(part), shape, linear_only, form, device)
        };
        let pooling =
            |part: &str, shape| AttentivePooling::load(weights, &name(part), shape, form, device);
        Ok(Self {
            narrow: mlp("mlp1", [input, d / 2], false)?,
            first_code: mlp("lfa.mlp1", [POSITION_CHANNELS, d / 2], false)?,
            first_pooling: pooling("lfa.att_pooling_1", [d, d / 2])?,
            second_code: mlp("lfa.mlp2", [d / 2, d / 2], false)?,
            second_pooling: pooling("lfa.att_pooling_2", [d, d])?,
            widen: mlp("mlp2", [d, 2 * d], true)?,
            shortcut: mlp("shortcut", [input, 2 * d], true)?,
            width: d,
        })
    }

    fn save(&self, weights: &mut Checkpoint, n: usize) {
        let name = |part: &str| format!("dilated_res_blocks.{n}.{part}");
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
        let code = self
            .first_code
            .forward(position_code(level, all.clone(), &features.device()));
        let gathered = gather(&narrow, level, all.clone());
        let pooled = self.first_pooling.forward(
            Tensor::cat(vec![gathered, code.clone()], 1),
            level.neighbours.k,
        );
        let code = self.second_code.forward(code);
        let gathered = gather(&pooled, level, all);
        let pooled = self
            .second_pooling
            .forward(Tensor::cat(vec![gathered, code], 1), level.neighbours.k);
        leaky_relu(self.widen.forward(pooled) + self.shortcut.forward(features))
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
            let code = self
                .first_code
                .forward(position_code(level, range.clone(), &device));
            self.first_pooling
                .forward(Tensor::cat(vec![gather(&narrow, level, range), code], 1), k)
        });
        chunks(&|range| {
            let code = self
                .first_code
                .forward(position_code(level, range.clone(), &device));
            let code = self.second_code.forward(code);
            let gathered = gather(&pooled, level, range.clone());
            let pooled = self
                .second_pooling
                .forward(Tensor::cat(vec![gathered, code], 1), k);
            let shortcut = self.shortcut.forward(features.clone().slice([range]));
            leaky_relu(self.widen.forward(pooled) + shortcut)
        })
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
    pub fn load(weights: &Checkpoint, form: Form, device: &Device) -> Result<Self> {
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
            let width = weights.shape(&format!(
                "dilated_res_blocks.{n}.lfa.att_pooling_2.fc.weight"
            ))?;
            let d = width.first().copied().unwrap_or_default();
            blocks.push(ResidualBlock::load(weights, n, [input, d], form, device)?);
            input = 2 * d;
        }
        let stem = SharedMlp::load(weights, "fc0", [inputs, stem], false, form, device)?;
        Ok(Self {
            stem,
            blocks,
            inputs,
        })
    }

    /// All weights under the names that [`RandlaEncoder::load`] reads.
    pub fn to_checkpoint(&self, origin: &str) -> Checkpoint {
        let mut weights = Checkpoint {
            origin: origin.into(),
            ..Checkpoint::default()
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
            let (output, together) = match chunked {
                true => (
                    block.forward_chunked(features, level),
                    CHUNK_VALUES / (level.neighbours.k * 2 * block.width),
                ),
                false => (block.forward(features, level), level.kept.len()),
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
    tensor(code, [rows, POSITION_CHANNELS], device)
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

pub(crate) fn tensor<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

pub(crate) fn parameter<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Param<Tensor<D>> {
    Param::from_tensor(tensor(values, shape, device))
}

#[cfg(all(test, feature = "ndarray"))]
mod tests {
    use super::*;
    use burn::tensor::DType;

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
