//! Pre-norm transformer blocks, which DINO and the text encoder of CLIP share, and layers read from weight files.

use crate::backend::device::upload;
use crate::error::{Error, Result};
use crate::weights::WeightFile;
use burn::module::{Module, Param};
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::activation::{gelu, sigmoid};
use burn::tensor::module::attention;
use burn::tensor::ops::AttentionModuleOptions;
use burn::tensor::{Device, Tensor};
use std::fmt::Display;

/// Channels of an attention head: there are `width / 64` heads.
pub const HEAD: usize = 64;

/// Queries attended at once. Memory for scores grows with this, not with the square of the number of tokens.
const QUERIES: usize = 256;

/// The nonlinearity of the perceptrons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activation {
    /// x times the Gaussian distribution function of x.
    #[default]
    Gelu,
    /// x times the logistic function of 1.702 x.
    QuickGelu,
}

/// Differences between the blocks of DINO and of CLIP's text encoder.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Style {
    pub activation: Activation,
    /// Whether a token attends only to itself and the tokens before it.
    pub is_causal: bool,
}

/// A pre-norm transformer block: self-attention and a perceptron, each added to its input.
#[derive(Module, Debug)]
pub(super) struct Block {
    pub norm1: LayerNorm,
    /// Queries, keys and values: `[width, 3 * width]`.
    pub qkv: Linear,
    pub projection: Linear,
    pub norm2: LayerNorm,
    pub fc1: Linear,
    pub fc2: Linear,
}

impl Block {
    /// Tokens `[B, N, width]`.
    pub fn forward(&self, x: Tensor<3>, style: Style) -> Tensor<3> {
        // The causal mask counts positions from the first query of a call, so all queries have to be in one call.
        let queries = if style.is_causal {
            x.dims()[1]
        } else {
            QUERIES
        };
        let attended = self.attend(self.norm1.forward(x.clone()), queries, style.is_causal);
        let x = x + self.projection.forward(attended);
        let hidden = self.fc1.forward(self.norm2.forward(x.clone()));
        let hidden = match style.activation {
            Activation::Gelu => gelu(hidden),
            Activation::QuickGelu => hidden.clone() * sigmoid(hidden * 1.702),
        };
        x + self.fc2.forward(hidden)
    }

    /// Attention of all heads, for `queries` tokens at a time. Their number changes the memory used, and the result only by
    /// rounding.
    fn attend(&self, x: Tensor<3>, queries: usize, is_causal: bool) -> Tensor<3> {
        let [batch, tokens, width] = x.dims();
        let qkv = self.qkv.forward(x);
        let [query, key, value] = [0, 1, 2].map(|part| {
            qkv.clone()
                .narrow(2, part * width, width)
                .reshape([batch, tokens, width / HEAD, HEAD])
                .swap_dims(1, 2)
        });
        let chunks = query.split(queries, 2).into_iter().map(|query| {
            let options = AttentionModuleOptions {
                is_causal,
                ..AttentionModuleOptions::default()
            };
            attention(query, key.clone(), value.clone(), None, None, options)
        });
        Tensor::cat(chunks.collect(), 2)
            .swap_dims(1, 2)
            .reshape([batch, tokens, width])
    }
}

/// The weights of a file and where they go.
pub(super) struct Weights<'a> {
    pub file: WeightFile,
    pub device: &'a Device,
    /// Epsilon of the layer normalisations.
    pub epsilon: f64,
}

impl Weights<'_> {
    /// The error for the tensor or block `name`.
    pub fn problem(&self, name: &str, found: impl Display, expected: impl Display) -> Error {
        self.file.problem(name, found, expected)
    }

    /// One more than the highest number that follows `prefix`. A gap becomes an error when its tensors are read.
    pub fn depth(&self, prefix: &str) -> Result<usize> {
        let names = self.file.tensors.keys();
        let numbers = names.filter_map(|name| name.strip_prefix(prefix)?.split('.').next());
        let mut depth = 0;
        for number in numbers {
            match number.parse::<usize>() {
                Ok(n) if n < self.file.tensors.len() => depth = depth.max(n + 1),
                _ => {
                    let name = format!("{prefix}{number}");
                    let expected = format!("{prefix}0, {prefix}1, ...");
                    return Err(self.problem(&name, "this block", expected));
                }
            }
        }
        match depth {
            0 => Err(self.problem(&format!("{prefix}0"), "no such block", "one or more")),
            depth => Ok(depth),
        }
    }

    /// What `of` makes of the shape of a tensor.
    pub fn shape<T>(
        &self,
        name: &str,
        expected: &str,
        of: impl Fn(&[usize]) -> Option<T>,
    ) -> Result<T> {
        let shape = self.file.shape(name)?;
        of(shape).ok_or_else(|| self.problem(name, format!("shape {shape:?}"), expected))
    }

    /// The outputs of the layer `name` of `width` inputs.
    pub fn outputs(&self, name: &str, width: usize) -> Result<usize> {
        let expected = format!("[hidden, {width}]");
        self.shape(&format!("{name}.weight"), &expected, |shape| match *shape {
            [hidden, found] if found == width && hidden > 0 => Some(hidden),
            _ => None,
        })
    }

    /// The layer whose weights have the shape `[out, in]`, or `[out, ...]` with the extents of the inputs.
    pub fn linear(&self, name: &str, shape: &[usize]) -> Result<Linear> {
        let weight = self.tensor(&format!("{name}.weight"), shape)?;
        let weight: Tensor<2> = weight.reshape([shape[0], shape[1..].iter().product()]);
        let bias = self.tensor(&format!("{name}.bias"), &shape[..1])?;
        Ok(linear(weight, bias))
    }

    /// The layer normalisation of `width` channels.
    pub fn norm(&self, name: &str, width: usize) -> Result<LayerNorm> {
        let mut norm = LayerNormConfig::new(width)
            .with_epsilon(self.epsilon)
            .init(self.device);
        norm.gamma = self.parameter(&format!("{name}.weight"), [width])?;
        norm.beta = Some(self.parameter(&format!("{name}.bias"), [width])?);
        Ok(norm)
    }

    pub fn parameter<const D: usize>(
        &self,
        name: &str,
        shape: [usize; D],
    ) -> Result<Param<Tensor<D>>> {
        let values = self.tensor(name, &shape)?;
        Ok(Param::from_tensor(values.reshape(shape)))
    }

    /// The values of a tensor of this shape, in one row.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Tensor<1>> {
        let values = self.file.get(name, shape)?;
        Ok(upload(values.to_vec(), [values.len()], self.device))
    }
}

/// The layer with `weight` `[out, in]`: burn keeps weights as `[in, out]`.
pub(super) fn linear(weight: Tensor<2>, bias: Tensor<1>) -> Linear {
    Linear {
        weight: Param::from_tensor(weight.transpose()),
        bias: Some(Param::from_tensor(bias)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{open_cpu, read};

    #[test]
    fn attention_in_chunks_equals_attention_at_once() {
        let device = open_cpu().unwrap();
        let (tokens, width) = (300, 2 * HEAD);
        // Squares of the index: values that do not repeat, so that sums of their products do not cancel.
        let wave = |count: usize, step: f64| {
            let values = (0..count).map(|i| (step * (i * i) as f64).sin() as f32);
            values.collect::<Vec<_>>()
        };
        let linear = |outputs: usize| {
            let weight =
                upload(wave(width * outputs, 1.3), [width, outputs], &device) / width as f64;
            Linear {
                weight: Param::from_tensor(weight),
                bias: None,
            }
        };
        let norm = || LayerNormConfig::new(width).init(&device);
        let block = Block {
            norm1: norm(),
            qkv: linear(3 * width),
            projection: linear(width),
            norm2: norm(),
            fc1: linear(width),
            fc2: linear(width),
        };
        let x = upload(wave(tokens * width, 0.7), [1, tokens, width], &device);
        let attended =
            |queries| read("attention", block.attend(x.clone(), queries, false)).unwrap();
        let at_once = attended(tokens);
        let largest = at_once.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
        assert!(largest > 0.0);
        for queries in [1, 7, 64] {
            for (a, b) in attended(queries).iter().zip(&at_once) {
                assert!((a - b).abs() < 2e-6 * largest, "{queries}: {a} {b}");
            }
        }
    }
}
