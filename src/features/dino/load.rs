//! DINO weights from `.safetensors` or PyTorch files, with the key names of facebookresearch/dino.
//!
//! Published backbones have the keys at the top. Full checkpoints hold two networks, under `teacher` and `student`, and
//! prefixes `module.` and `backbone.`. The teacher gives DINO's published results, so we take it.

use super::position::PositionEmbedding;
use super::{Block, HEAD, Vit};
use crate::backend::device::upload;
use crate::error::{Error, Result};
use crate::weights::WeightFile;
use burn::module::Param;
use burn::nn::{LayerNorm, LayerNormConfig, Linear};
use burn::tensor::{Device, Tensor};
use std::fmt::Display;
use std::path::Path;

/// Epsilon of the layer normalisations.
const EPSILON: f64 = 1e-6;

/// Tensors of a block.
const PARTS: [&str; 6] = [
    "norm1",
    "attn.qkv",
    "attn.proj",
    "norm2",
    "mlp.fc1",
    "mlp.fc2",
];

const NETWORK: &str =
    "a DINO ViT (keys `cls_token`, `pos_embed`, `patch_embed.proj.*`, `blocks.N.*`, `norm.*`)";

impl Vit {
    /// Reads weights from a `.safetensors` file, or from any other file as a PyTorch checkpoint. Width, depth, patch size,
    /// hidden width and the grid of position embeddings are those of the tensors; there is a head for every [`HEAD`] channels.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file cannot be read; [`crate::Error::Input`] when it is damaged, when tensors are missing, have
    /// shapes that do not go together, hold a value that is not finite, or belong to another network.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        // The student and the optimiser's state are three quarters of a full checkpoint.
        let needed = |name: &str| !name.starts_with("student.") && !name.starts_with("optimizer.");
        let mut file = network(WeightFile::open_where(path, needed)?);
        if !file.tensors.contains_key("cls_token") {
            file = network(WeightFile::open(path)?);
        }
        let weights = Weights { file, device };
        weights.check_kind()?;
        let (width, patch) = weights.patch()?;
        let side = weights.side(width)?;
        let blocks = (0..weights.depth()?).map(|n| weights.block(n, width));
        let places = 1 + side * side;
        let positions = weights.tensor("pos_embed", &[1, places, width])?;
        Ok(Self {
            patch,
            embedding: weights.linear("patch_embed.proj", &[width, 3, patch, patch])?,
            class_token: weights.parameter("cls_token", [1, 1, width])?,
            positions: PositionEmbedding {
                side,
                values: Param::from_tensor(positions.reshape([places, width])),
            },
            blocks: blocks.collect::<Result<_>>()?,
            norm: weights.norm("norm", width)?,
        })
    }
}

/// The tensors of the network in `file`: of the teacher, else of one under neither name, else of the student.
fn network(file: WeightFile) -> WeightFile {
    let rank = |prefix: &str| {
        let mut parts = prefix.split('.');
        match parts.find(|part| ["teacher", "student"].contains(part)) {
            Some("teacher") => 0,
            Some(_) => 2,
            None => 1,
        }
    };
    let names = file.tensors.keys();
    let prefix = names
        .filter_map(|name| name.strip_suffix("cls_token"))
        .filter(|prefix| prefix.is_empty() || prefix.ends_with('.'))
        .min_by_key(|prefix| (rank(prefix), prefix.len()))
        .unwrap_or_default()
        .to_owned();
    file.under(&prefix).of_network(NETWORK)
}

/// The weights of a file and where they go.
struct Weights<'a> {
    file: WeightFile,
    device: &'a Device,
}

impl Weights<'_> {
    /// The error for the tensor or block `name`.
    fn problem(&self, name: &str, found: impl Display, expected: impl Display) -> Error {
        self.file.problem(name, found, expected)
    }

    /// Refuses relatives that compute something else: DINOv2 scales its layers and may have registers, iBOT masks.
    fn check_kind(&self) -> Result<()> {
        for name in self.file.tensors.keys() {
            let Some(rest) = name.strip_prefix("blocks.") else {
                if name == "register_tokens" {
                    let expected = "none of this name: DINOv2's registers are not read";
                    return Err(self.problem(name, "this tensor", expected));
                }
                continue;
            };
            let part = rest.split_once('.').map_or("", |(_, part)| part);
            let known = part
                .rsplit_once('.')
                .is_some_and(|(p, w)| PARTS.contains(&p) && ["weight", "bias"].contains(&w));
            if !known {
                let parts = PARTS.join(", ");
                let expected = format!("weight and bias of {parts} in each block, nothing else");
                return Err(self.problem(name, "this tensor", expected));
            }
        }
        Ok(())
    }

    /// What `of` makes of the shape of a tensor.
    fn shape<T>(
        &self,
        name: &str,
        expected: &str,
        of: impl Fn(&[usize]) -> Option<T>,
    ) -> Result<T> {
        let shape = self.file.shape(name)?;
        of(shape).ok_or_else(|| self.problem(name, format!("shape {shape:?}"), expected))
    }

    /// Width and patch size.
    fn patch(&self) -> Result<(usize, usize)> {
        let expected = format!("[width, 3, patch, patch], width a multiple of {HEAD}");
        self.shape("patch_embed.proj.weight", &expected, |shape| match *shape {
            [width, 3, patch, columns] => {
                let fits = patch == columns && patch > 0 && width > 0 && width % HEAD == 0;
                fits.then_some((width, patch))
            }
            _ => None,
        })
    }

    /// Cells along a side of the grid of position embeddings.
    fn side(&self, width: usize) -> Result<usize> {
        let expected = format!("[1, 1 + side x side, {width}], a class token and a square grid");
        self.shape("pos_embed", &expected, |shape| match *shape {
            [1, tokens, found] if found == width && tokens > 1 => {
                let side = (tokens - 1).isqrt();
                (side.pow(2) == tokens - 1).then_some(side)
            }
            _ => None,
        })
    }

    /// One more than the highest number of a block. A gap becomes an error when its tensors are read.
    fn depth(&self) -> Result<usize> {
        let names = self.file.tensors.keys();
        let numbers = names.filter_map(|name| name.strip_prefix("blocks.")?.split('.').next());
        let mut depth = 0;
        for number in numbers {
            match number.parse::<usize>() {
                Ok(n) if n < self.file.tensors.len() => depth = depth.max(n + 1),
                _ => {
                    let name = format!("blocks.{number}");
                    return Err(self.problem(&name, "this block", "blocks.0, blocks.1, ..."));
                }
            }
        }
        match depth {
            0 => Err(self.problem("blocks.0", "no such block", "one or more")),
            depth => Ok(depth),
        }
    }

    fn block(&self, n: usize, width: usize) -> Result<Block> {
        let name = |part: &str| format!("blocks.{n}.{part}");
        let fc1 = name("mlp.fc1.weight");
        let hidden = self.shape(&fc1, &format!("[hidden, {width}]"), |shape| match *shape {
            [hidden, found] if found == width && hidden > 0 => Some(hidden),
            _ => None,
        })?;
        Ok(Block {
            norm1: self.norm(&name("norm1"), width)?,
            qkv: self.linear(&name("attn.qkv"), &[3 * width, width])?,
            projection: self.linear(&name("attn.proj"), &[width, width])?,
            norm2: self.norm(&name("norm2"), width)?,
            fc1: self.linear(&name("mlp.fc1"), &[hidden, width])?,
            fc2: self.linear(&name("mlp.fc2"), &[width, hidden])?,
        })
    }

    /// The layer whose weights have the shape `[out, in]`, or `[out, ...]` with the extents of the inputs.
    fn linear(&self, name: &str, shape: &[usize]) -> Result<Linear> {
        let weight = self.tensor(&format!("{name}.weight"), shape)?;
        let weight: Tensor<2> = weight.reshape([shape[0], shape[1..].iter().product()]);
        Ok(Linear {
            // Burn keeps weights as [in, out].
            weight: Param::from_tensor(weight.transpose()),
            bias: Some(self.parameter(&format!("{name}.bias"), [shape[0]])?),
        })
    }

    fn norm(&self, name: &str, width: usize) -> Result<LayerNorm> {
        let mut norm = LayerNormConfig::new(width)
            .with_epsilon(EPSILON)
            .init(self.device);
        norm.gamma = self.parameter(&format!("{name}.weight"), [width])?;
        norm.beta = Some(self.parameter(&format!("{name}.bias"), [width])?);
        Ok(norm)
    }

    fn parameter<const D: usize>(&self, name: &str, shape: [usize; D]) -> Result<Param<Tensor<D>>> {
        let values = self.tensor(name, &shape)?;
        Ok(Param::from_tensor(values.reshape(shape)))
    }

    /// The values of a tensor of this shape, in one row.
    fn tensor(&self, name: &str, shape: &[usize]) -> Result<Tensor<1>> {
        let values = self.file.get(name, shape)?;
        Ok(upload(values.to_vec(), [values.len()], self.device))
    }
}
