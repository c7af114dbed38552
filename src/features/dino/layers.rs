//! Layers of a pre-norm transformer block, on chunks of tokens.

use super::attention::attend;
use super::kernels::gelu;
use crate::backend::matmul::add_product;
use crate::error::Result;
use rayon::prelude::*;

/// Tokens handled at once, per thread.
pub(super) const ROWS: usize = 256;

/// Added to variances.
const EPSILON: f64 = 1e-6;

/// `x W^T + b`.
#[derive(Clone, Debug)]
pub(super) struct Linear {
    /// W transposed, `[in, out]`: products read it as it lies.
    weights: Vec<f32>,
    /// `[out]`.
    bias: Vec<f32>,
}

impl Linear {
    /// From weights `[out, in]` as files have them, and a bias `[out]`.
    pub fn new(weights: &[f32], bias: Vec<f32>) -> Self {
        let inputs = weights.len() / bias.len().max(1);
        let column = |i: usize| weights.iter().skip(i).step_by(inputs).copied();
        Self {
            weights: (0..inputs).flat_map(column).collect(),
            bias,
        }
    }

    /// `x W^T + b` for rows `x`.
    pub fn apply(&self, x: &[f32]) -> Vec<f32> {
        let inputs = self.weights.len() / self.bias.len();
        let mut out = vec![0.0; x.len() / inputs * self.bias.len()];
        self.add_to(x, &mut out);
        out
    }

    /// `out += x W^T + b` for rows `x`.
    pub fn add_to(&self, x: &[f32], out: &mut [f32]) {
        let (inputs, outputs) = (self.weights.len() / self.bias.len(), self.bias.len());
        for row in out.chunks_exact_mut(outputs) {
            row.iter_mut().zip(&self.bias).for_each(|(x, b)| *x += b);
        }
        add_product(x, inputs, &self.weights, outputs, out);
    }
}

/// Layer normalisation over the channels of each token.
#[derive(Clone, Debug)]
pub(super) struct LayerNorm {
    /// Scale, `[width]`.
    pub weight: Vec<f32>,
    /// Shift, `[width]`.
    pub bias: Vec<f32>,
}

impl LayerNorm {
    /// Rows of `x` into rows of `out`.
    pub fn apply(&self, x: &[f32], out: &mut [f32]) {
        let d = self.weight.len().max(1);
        for (x, out) in x.chunks_exact(d).zip(out.chunks_exact_mut(d)) {
            let mean = x.iter().map(|&v| f64::from(v)).sum::<f64>() / d as f64;
            let variance = x
                .iter()
                .map(|&v| (f64::from(v) - mean).powi(2))
                .sum::<f64>()
                / d as f64;
            let scale = 1.0 / (variance + EPSILON).sqrt();
            for (((o, &v), &w), &b) in out.iter_mut().zip(x).zip(&self.weight).zip(&self.bias) {
                *o = ((f64::from(v) - mean) * scale) as f32 * w + b;
            }
        }
    }

    fn applied(&self, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; x.len()];
        self.apply(x, &mut out);
        out
    }
}

/// Self-attention and a perceptron, each normalised before and added to its input.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub norm1: LayerNorm,
    /// Queries, keys, values: `[3 * width, width]`.
    pub qkv: Linear,
    pub projection: Linear,
    pub norm2: LayerNorm,
    pub fc1: Linear,
    pub fc2: Linear,
}

impl Block {
    /// Tokens `x`, `[n, d]`, in place; attention for `queries` of them at a time. `number` names the block in errors.
    pub fn forward(&self, x: &mut [f32], d: usize, queries: usize, number: usize) -> Result<()> {
        let mut qkv = vec![0.0; 3 * x.len()];
        qkv.par_chunks_mut(ROWS * 3 * d)
            .zip(x.par_chunks(ROWS * d))
            .for_each(|(out, x)| self.qkv.add_to(&self.norm1.applied(x), out));
        attend(&qkv, d, queries, x, &self.projection, number)?;
        drop(qkv);
        x.par_chunks_mut(ROWS * d).for_each(|x| {
            let mut hidden = self.fc1.apply(&self.norm2.applied(x));
            gelu(&mut hidden);
            self.fc2.add_to(&hidden, x);
        });
        Ok(())
    }
}
