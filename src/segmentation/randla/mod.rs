//! RandLA-Net's encoder (Hu et al. 2020), as burn modules.
//!
//! Features are `[rows, channels]` throughout. A tensor over the `K` neighbours of `R` points has `K R` rows, first those of
//! the first neighbours: sums over neighbours then add long contiguous arrays. 1x1 convolutions are linear layers. Key names and
//! wiring are those of the PyTorch port whose checkpoints are published.

mod neighbourhood;
mod weights;

pub(super) use self::weights::block_name;

use self::neighbourhood::{attentive_mean, gather, position_code, sample};
use super::linear::leaky_relu;
use super::sampling::{Hierarchy, SampledLevel};
use burn::module::Module;
use burn::nn::{BatchNorm, Linear};
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use std::ops::Range;

/// Channels of the relative position code: distance, p_i - p_k, p_i, p_k.
pub const POSITION_CHANNELS: usize = 10;

/// Values that [`RandlaEncoder::encode_levels`] holds per tensor in one chunk of points, when it may chunk.
const CHUNK_VALUES: usize = 1 << 19;

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

    /// `linear` and LeakyReLU.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        leaky_relu(self.linear(x))
    }
}

/// Weighted sum over the neighbours of each point, weights learned per channel, then a shared MLP.
#[derive(Module, Debug)]
pub struct AttentivePooling {
    score: Linear,
    mlp: SharedMlp,
}

impl AttentivePooling {
    /// `[R, out]` for the points in `range`, from `features` of all points and the position `code` of their neighbours. Each
    /// channel is a weighted mean over the K neighbours of a point; the weights are the softmax of `x W` over the neighbours.
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
        let points = level.positions.len();
        let k = level.neighbours.k;
        let device = features.device();
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
    /// Channels of the input: 3 (xyz) or 6 (xyz, rgb in 0..1).
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// The encoder without the blocks from `count` on, whose levels nothing reads.
    #[must_use]
    pub fn first_blocks(mut self, count: usize) -> Self {
        self.blocks.truncate(count);
        self
    }

    /// Channels of the features of each level; the coarsest set has those of the last.
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
