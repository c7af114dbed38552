//! The decoder (Eq. 7): image and spatial features fused from global to local into one identity a Gaussian.
//!
//! Only its parameters are learned. Everything it reads is frozen, so the inputs of a level are concatenated once, and
//! linear maps are applied before upsampling rather than after: US(x) W = US(x W), on a quarter of the rows.

use super::encoder::Encoding;
use crate::error::{Error, Result};
use crate::ops::{SparseMatrix, sparse_apply};
use burn::module::Module;
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Int, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

use super::randla::{SLOPE, parameter};

/// Widths of the shared MLPs at scales 1 to 4.
pub const WIDTHS: [usize; 4] = [64, 64, 128, 256];
/// Channels of the hidden features that are blended; the last FC maps them to classes.
pub const HIDDEN: usize = WIDTHS[0];
/// Purpose of the random stream of the first weights.
const INIT_STREAM: u64 = 0x6465_636f;

/// Which features the decoder reads: the switches of the ablation table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switches {
    /// Image features f_d,n.
    pub image: bool,
    /// Spatial features f_s,n and f_e.
    pub spatial: bool,
    /// All scales, or one: level 1 alone, with the image features of the scale given (0 is scale 1).
    pub single_scale: Option<usize>,
}

impl Default for Switches {
    fn default() -> Self {
        Self { image: true, spatial: true, single_scale: None }
    }
}

/// Frozen inputs of one scale, on `N_n` points.
#[derive(Clone, Debug)]
pub struct DecoderLevel {
    /// f_d,n and f_s,n side by side, `[N_n, D_n]`, without autodiff; absent when both are switched off.
    pub features: Option<Tensor<2>>,
    /// Interpolation onto these points from the next coarser set; absent where nothing comes from below.
    pub upsample: Option<Arc<SparseMatrix>>,
}

/// Frozen inputs of all scales, finest first.
#[derive(Clone, Debug)]
pub struct DecoderInput {
    /// Scales 1 to 4, or scale 1 alone.
    pub levels: Vec<DecoderLevel>,
    /// f_e on the last sampled set.
    pub coarsest: Option<Tensor<2>>,
}

impl DecoderInput {
    /// Puts an encoding and the unprojected features together. `image[n]` is f_d of scale n + 1 for the whole encoded
    /// cloud, `[N, D]`, without autodiff; each level reads the rows of its own points.
    ///
    /// # Errors
    /// [`Error::Config`] when all features are off, or image features are on and missing or of another length.
    pub fn new(encoding: &Encoding, image: &[Tensor<2>], switches: Switches) -> Result<Self> {
        if !switches.image && !switches.spatial {
            let mend = "leave image or spatial features on";
            return Err(Error::config("decoder inputs", "none", "image features, spatial features or both", mend));
        }
        let count = if switches.single_scale.is_some() { 1 } else { encoding.levels.len() };
        let mut levels = Vec::with_capacity(count);
        for (n, level) in encoding.levels.iter().take(count).enumerate() {
            let mut parts = Vec::with_capacity(2);
            if switches.image {
                let scale = switches.single_scale.unwrap_or(n);
                let lifted = image.get(scale).filter(|f| f.dims()[0] == encoding.levels[0].indices.len());
                let lifted = lifted.ok_or_else(|| {
                    let found = format!("{:?}", image.get(scale).map(Tensor::dims));
                    let expected = format!("{} rows", encoding.levels[0].indices.len());
                    Error::config(
                        format!("image features of scale {}", scale + 1),
                        found,
                        expected,
                        "unproject them first",
                    )
                })?;
                parts.push(if n == 0 { lifted.clone() } else { select(lifted, &level.indices) });
            }
            if switches.spatial {
                parts.push(level.features.clone());
            }
            // without spatial features nothing lies below scale 4, with one scale nothing below scale 1
            let below = switches.single_scale.is_none() && (switches.spatial || n + 1 < count);
            levels.push(DecoderLevel {
                features: Some(Tensor::cat(parts, 1)),
                upsample: below.then(|| encoding.upsample[n].clone()),
            });
        }
        let coarsest = switches.spatial && switches.single_scale.is_none();
        Ok(Self { levels, coarsest: coarsest.then(|| encoding.coarsest.features.clone()) })
    }

    /// Bytes of the features and maps of the `depth` finest levels: what a restriction to that depth holds of its own.
    pub fn bytes(&self, depth: usize) -> usize {
        let level = |l: &DecoderLevel| {
            let features = l.features.as_ref().map_or(0, |f| 4 * f.shape().num_elements());
            features + l.upsample.as_ref().map_or(0, |m| m.bytes())
        };
        self.levels.iter().take(depth).map(level).sum()
    }

    /// Number of points of the finest level.
    pub fn points(&self) -> usize {
        let level = self.levels.first();
        level.and_then(|l| l.features.as_ref()).map_or(0, |f| f.dims()[0])
    }

    /// The part of the input that decides `rows` of the finest level: `depth` finest levels keep only the points that
    /// those rows depend on, coarser ones stay whole. Decoding it gives the hidden features of `rows`, in their order,
    /// and the same fused features from level `depth + 1` on. A depth of 2 leaves scales 3 and 4 to the regularisation.
    ///
    /// # Panics
    /// If a row is not below [`DecoderInput::points`].
    #[must_use]
    pub fn restrict(&self, rows: &[u32], depth: usize) -> Self {
        let mut restricted = self.clone();
        let mut rows = rows.to_vec();
        for (n, level) in restricted.levels.iter_mut().enumerate().take(depth) {
            level.features = level.features.as_ref().map(|f| select(f, &rows));
            let Some(matrix) = &level.upsample else { break };
            let last = n + 1 == depth || n + 1 == self.levels.len();
            let (matrix, columns) = restrict_matrix(matrix, &rows, last);
            level.upsample = Some(Arc::new(matrix));
            rows = columns;
        }
        restricted
    }
}

/// Rows of a matrix, over all columns or only those used, which are returned ascending.
fn restrict_matrix(matrix: &SparseMatrix, rows: &[u32], all_columns: bool) -> (SparseMatrix, Vec<u32>) {
    let mut part = SparseMatrix { columns: matrix.columns, offsets: vec![0], ..SparseMatrix::default() };
    for &r in rows {
        let (columns, values) = matrix.row(r as usize);
        part.indices.extend_from_slice(columns);
        part.values.extend_from_slice(values);
        part.offsets.push(part.indices.len() as u32);
    }
    if all_columns {
        return (part, Vec::new());
    }
    let mut columns = part.indices.clone();
    columns.sort_unstable();
    columns.dedup();
    let mut place = vec![0u32; matrix.columns];
    for (i, &c) in columns.iter().enumerate() {
        place[c as usize] = i as u32;
    }
    part.indices.iter_mut().for_each(|c| *c = place[*c as usize]);
    part.columns = columns.len();
    (part, columns)
}

/// Shared MLP over the frozen features of a level and what comes up from below.
#[derive(Module, Debug)]
struct FusionLayer {
    /// Holds the bias.
    frozen: Linear,
    below: Option<Linear>,
    norm: Option<LayerNorm>,
}

/// What one decoding gives.
#[derive(Clone, Debug)]
pub struct Decoded {
    /// `[N_1, 64]` (or one row a selected point): blend these, then [`Decoder::classify`] per pixel.
    pub hidden: Tensor<2>,
    /// Fused features of every scale, finest first, `[N_n, width]`: what Eq. 9 reads at n = 3, 4.
    pub fused: Vec<Tensor<2>>,
}

/// The decoder: a shared MLP a scale, LeakyReLU 0.2, and a last FC.
#[derive(Module, Debug)]
pub struct Decoder {
    layers: Vec<FusionLayer>,
    last: Linear,
}

impl Decoder {
    /// A decoder for inputs like `input`, with seeded first weights (uniform, +-1/sqrt(inputs of the layer)).
    ///
    /// # Errors
    /// [`Error::Config`] without classes or without features.
    pub fn new(input: &DecoderInput, classes: usize, layer_norm: bool, seed: u64, device: &Device) -> Result<Self> {
        if classes == 0 || input.levels.is_empty() || input.levels.len() > WIDTHS.len() {
            let found = format!("{classes} classes, {} levels", input.levels.len());
            return Err(Error::config("decoder", found, "classes, and 1 to 4 levels", "give a labelled scene"));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(INIT_STREAM);
        let mut layers = Vec::with_capacity(input.levels.len());
        for (n, level) in input.levels.iter().enumerate() {
            let frozen = level.features.as_ref().map_or(0, |f| f.dims()[1]);
            let coarsest = input.coarsest.as_ref().map_or(0, |f| f.dims()[1]);
            let below = match &level.upsample {
                Some(_) if n + 1 < input.levels.len() => WIDTHS[n + 1],
                Some(_) => coarsest,
                None => 0,
            };
            let (inputs, width) = (frozen + below, WIDTHS[n]);
            layers.push(FusionLayer {
                frozen: linear([frozen, width], inputs, true, &mut rng, device),
                below: (below > 0).then(|| linear([below, width], inputs, false, &mut rng, device)),
                norm: layer_norm.then(|| LayerNormConfig::new(width).init(device)),
            });
        }
        let last = linear([HIDDEN, classes], HIDDEN, true, &mut rng, device);
        Ok(Self { layers, last })
    }

    /// Decodes from global to local. Gradients flow to the parameters only.
    ///
    /// # Panics
    /// If `input` has other levels or widths than the decoder was made for.
    pub fn forward(&self, input: &DecoderInput) -> Decoded {
        assert_eq!(self.layers.len(), input.levels.len(), "levels of the input against layers of the decoder");
        let device = self.last.weight.device();
        let mut below = input.coarsest.as_ref().map(|f| tracked(f, &device));
        let mut fused = Vec::with_capacity(self.layers.len());
        for (layer, level) in self.layers.iter().zip(&input.levels).rev() {
            let mut parts = Vec::with_capacity(2);
            if let Some(features) = &level.features {
                parts.push(layer.frozen.forward(tracked(features, &device)));
            }
            if let (Some(map), Some(matrix), Some(x)) = (&layer.below, &level.upsample, below.take()) {
                parts.push(sparse_apply(map.forward(x), matrix.clone()));
            }
            let Some(x) = parts.into_iter().reduce(|a, b| a + b) else { continue };
            let x = match &layer.norm {
                Some(norm) => norm.forward(x),
                None => x,
            };
            let x = leaky_relu(x, SLOPE);
            below = Some(x.clone());
            fused.push(x);
        }
        fused.reverse();
        Decoded { hidden: fused.first().cloned().unwrap_or_else(|| Tensor::zeros([0, HIDDEN], &device)), fused }
    }

    /// Logits `[rows, C]` of hidden features `[rows, 64]`, of Gaussians or of pixels.
    ///
    /// The FC commutes with blending: of hidden features blended with weights that sum to 1 - T, the blended logits are
    /// `blended W + (1 - T) b`. Divided by 1 - T, as the label loss wants them, they are `classify(blended / (1 - T))`.
    pub fn classify(&self, hidden: Tensor<2>) -> Tensor<2> {
        self.last.forward(hidden)
    }

    /// Bytes of the learned parameters.
    pub fn bytes(&self) -> usize {
        4 * self.num_params()
    }
}

fn linear(shape: [usize; 2], inputs: usize, bias: bool, rng: &mut ChaCha8Rng, device: &Device) -> Linear {
    let bound = 1.0 / (inputs.max(1) as f32).sqrt();
    let mut uniform = |count: usize| (0..count).map(|_| bound * rng.random_range(-1.0f32..1.0)).collect::<Vec<_>>();
    Linear {
        weight: parameter(uniform(shape[0] * shape[1]), shape, device),
        bias: bias.then(|| parameter(uniform(shape[1]), [shape[1]], device)),
    }
}

/// A frozen tensor beside parameters on `device`, with or without autodiff.
fn tracked(frozen: &Tensor<2>, device: &Device) -> Tensor<2> {
    match device.is_autodiff() && !frozen.device().is_autodiff() {
        true => Tensor::from_inner(frozen.clone()),
        false => frozen.clone(),
    }
}

fn select(features: &Tensor<2>, rows: &[u32]) -> Tensor<2> {
    let index: Vec<i64> = rows.iter().map(|&r| i64::from(r)).collect();
    let index = Tensor::<1, Int>::from_data(TensorData::new(index, [rows.len()]), &features.device());
    features.clone().select(0, index)
}
