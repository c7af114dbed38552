//! The weights of the encoder in a checkpoint, read and written. Key names are those of the PyTorch port.

use super::{AttentivePooling, POSITION_CHANNELS, RandlaEncoder, ResidualBlock, SharedMlp};
use crate::backend::device::{read, upload};
use crate::error::{Result, bail};
use crate::segmentation::linear::parameter;
use crate::segmentation::sampling::LAYERS;
use crate::weights::{HostTensor, WeightFile};
use burn::module::{Param, RunningState};
use burn::nn::{BatchNormConfig, Linear};
use burn::tensor::{Device, Tensor};

/// Epsilon of batch normalisation in the published port (PyTorch's default).
const NORM_EPSILON: f64 = 1e-5;
/// Share of a new batch in the running statistics while pretraining.
const NORM_MOMENTUM: f64 = 0.03;

impl RandlaEncoder {
    /// Reads the encoder of a checkpoint. Widths and inputs follow its tensors. Layers past the fourth are unused.
    ///
    /// # Errors
    /// [`crate::Error::Input`] naming the tensor that is missing, has a different shape than its neighbours ask for, or is not
    /// finite.
    pub fn load(weights: &WeightFile, device: &Device) -> Result<Self> {
        let loader = Loader { weights, device };
        let [stem, inputs] = match weights.shape("fc0.conv.weight")? {
            [stem, inputs, ..] if matches!(inputs, 3 | 6) => [*stem, *inputs],
            other => {
                bail!(&weights.origin, "fc0.conv.weight"; found "shape {other:?}";
                    expected "[width, 3] (xyz) or [width, 6] (xyz, rgb)";
                    help "give an encoder whose inputs are positions, with or without colours");
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
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn to_weight_file(&self, origin: &str) -> Result<WeightFile> {
        let mut weights = WeightFile {
            origin: origin.into(),
            ..WeightFile::default()
        };
        self.stem.save(&mut weights, "fc0")?;
        for (n, block) in self.blocks.iter().enumerate() {
            block.save(&mut weights, n)?;
        }
        Ok(weights)
    }
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
pub fn block_name(n: usize, part: &str) -> String {
    format!("dilated_res_blocks.{n}.{part}")
}

impl SharedMlp {
    fn save(&self, weights: &mut WeightFile, name: &str) -> Result<()> {
        save_matrix(weights, &format!("{name}.conv.weight"), &self.linear)?;
        for (part, values) in [
            ("weight", self.norm.gamma.val()),
            ("bias", self.norm.beta.val()),
            ("running_mean", self.norm.running_mean.value_sync()),
            ("running_var", self.norm.running_var.value_sync()),
        ] {
            let shape = values.dims().to_vec();
            let name = format!("{name}.bn.bn.{part}");
            let values = read(&name, values)?;
            weights.insert(&name, HostTensor { shape, values });
        }
        Ok(())
    }
}

impl AttentivePooling {
    fn save(&self, weights: &mut WeightFile, name: &str) -> Result<()> {
        save_matrix(weights, &format!("{name}.fc.weight"), &self.score)?;
        self.mlp.save(weights, &format!("{name}.mlp"))
    }
}

impl ResidualBlock {
    fn save(&self, weights: &mut WeightFile, n: usize) -> Result<()> {
        let name = |part: &str| block_name(n, part);
        self.narrow.save(weights, &name("mlp1"))?;
        self.first_code.save(weights, &name("lfa.mlp1"))?;
        self.first_pooling
            .save(weights, &name("lfa.att_pooling_1"))?;
        self.second_code.save(weights, &name("lfa.mlp2"))?;
        self.second_pooling
            .save(weights, &name("lfa.att_pooling_2"))?;
        self.widen.save(weights, &name("mlp2"))?;
        self.shortcut.save(weights, &name("shortcut"))
    }
}

fn save_matrix(weights: &mut WeightFile, name: &str, linear: &Linear) -> Result<()> {
    let [input, output] = linear.weight.dims();
    let values = transposed(&read(name, linear.weight.val())?, output, input);
    let shape = vec![output, input];
    weights.insert(name, HostTensor { shape, values });
    Ok(())
}

/// `[rows, columns]` from `[columns, rows]`, row-major.
fn transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..rows * columns)
        .map(|i| values[i % columns * rows + i / columns])
        .collect()
}
