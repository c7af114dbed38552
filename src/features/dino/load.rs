//! DINO weights from `.safetensors` or PyTorch files, with the key names of facebookresearch/dino.
//!
//! Published backbones have the keys at the top. Full checkpoints hold two networks, under `teacher` and `student`, and
//! prefixes `module.` and `backbone.`; the teacher is the one that DINO's results are of, and is taken.

use super::layers::{Block, LayerNorm, Linear};
use super::position::PositionEmbedding;
use super::{HEAD, QUERIES, Vit};
use crate::error::{Error, Result};
use crate::weights::Checkpoint;
use std::path::Path;

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

/// The weights under one prefix of a file.
struct Weights {
    file: Checkpoint,
    prefix: String,
}

impl Vit {
    /// Reads weights from a `.safetensors` file, or anything else as a PyTorch checkpoint. Width, depth, patch size, hidden
    /// width and the grid of position embeddings are those of the tensors; there is a head for every [`HEAD`] channels.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] when it is damaged, when tensors are missing, have
    /// shapes that do not go together, hold a value that is not finite, or are of another network.
    pub fn load(path: &Path) -> Result<Self> {
        // The student and the optimiser's state are three quarters of a full checkpoint.
        let weights = Weights::of(Checkpoint::open_where(path, |name| {
            !["student.", "optimizer."]
                .iter()
                .any(|part| name.starts_with(part))
        })?);
        let weights = match weights.present("cls_token") {
            true => weights,
            false => Weights::of(Checkpoint::open(path)?),
        };
        weights.check_kind()?;

        let (width, patch) = match weights.shape("patch_embed.proj.weight")? {
            &[width, 3, rows, columns]
                if rows == columns && rows > 0 && width > 0 && width % HEAD == 0 =>
            {
                (width, rows)
            }
            other => {
                let expected = format!("[width, 3, patch, patch], width a multiple of {HEAD}");
                return Err(weights.problem(
                    "patch_embed.proj.weight",
                    format!("shape {other:?}"),
                    expected,
                ));
            }
        };
        let side = match weights.shape("pos_embed")? {
            &[1, tokens, found]
                if found == width && tokens > 1 && (tokens - 1).isqrt().pow(2) == tokens - 1 =>
            {
                (tokens - 1).isqrt()
            }
            other => {
                let expected =
                    format!("[1, 1 + side x side, {width}], a class token and a square grid");
                return Err(weights.problem("pos_embed", format!("shape {other:?}"), expected));
            }
        };
        let embedding = Linear::new(
            &weights.values("patch_embed.proj.weight", &[width, 3, patch, patch])?,
            weights.values("patch_embed.proj.bias", &[width])?,
        );
        let depth = weights.depth()?;
        Ok(Self {
            width,
            patch,
            embedding,
            class_token: weights.values("cls_token", &[1, 1, width])?,
            positions: PositionEmbedding {
                side,
                values: weights.values("pos_embed", &[1, 1 + side * side, width])?,
            },
            blocks: (0..depth)
                .map(|n| weights.block(n, width))
                .collect::<Result<_>>()?,
            norm: weights.norm("norm", width)?,
            final_norm: true,
            queries: QUERIES,
        })
    }
}

impl Weights {
    /// Chooses the network: a teacher, else one under neither name, else a student.
    fn of(file: Checkpoint) -> Self {
        let prefixes = file
            .tensors
            .keys()
            .filter_map(|name| name.strip_suffix("cls_token"));
        let rank = |prefix: &str| match prefix {
            p if p.split('.').any(|part| part == "teacher") => 0,
            p if p.split('.').any(|part| part == "student") => 2,
            _ => 1,
        };
        let prefixes = prefixes.filter(|p| p.is_empty() || p.ends_with('.'));
        let prefix = prefixes
            .min_by_key(|p| (rank(p), p.len()))
            .unwrap_or_default()
            .to_owned();
        Self {
            file: file.of_network(NETWORK),
            prefix,
        }
    }

    fn present(&self, name: &str) -> bool {
        self.file
            .tensors
            .contains_key(&format!("{}{name}", self.prefix))
    }

    fn shape(&self, name: &str) -> Result<&[usize]> {
        self.file.shape(&format!("{}{name}", self.prefix))
    }

    fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        Ok(self
            .file
            .get(&format!("{}{name}", self.prefix), shape)?
            .to_vec())
    }

    fn problem(&self, name: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
        let field = format!("{}{name}", self.prefix);
        Error::input(
            &self.file.origin,
            field,
            found,
            expected,
            format!("give a checkpoint of {NETWORK}"),
        )
    }

    /// Names below the prefix.
    fn names(&self) -> impl Iterator<Item = &str> {
        self.file
            .tensors
            .keys()
            .filter_map(|name| name.strip_prefix(self.prefix.as_str()))
    }

    /// Refuses relatives that compute something else: DINOv2 scales its layers and may have registers, iBOT masks.
    fn check_kind(&self) -> Result<()> {
        for name in self.names() {
            let Some(rest) = name.strip_prefix("blocks.") else {
                if name == "register_tokens" {
                    return Err(self.problem(
                        name,
                        "this tensor",
                        "none of this name: DINOv2's registers are not read",
                    ));
                }
                continue;
            };
            let part = rest.split_once('.').map_or("", |(_, part)| part);
            let known = part
                .rsplit_once('.')
                .is_some_and(|(p, w)| PARTS.contains(&p) && ["weight", "bias"].contains(&w));
            if !known {
                let expected = format!(
                    "weight and bias of {} in each block, nothing else",
                    PARTS.join(", ")
                );
                return Err(self.problem(name, "this tensor", expected));
            }
        }
        Ok(())
    }

    /// One more than the highest number of a block; whether all below are there, their tensors tell.
    fn depth(&self) -> Result<usize> {
        let numbers = self
            .names()
            .filter_map(|name| name.strip_prefix("blocks.")?.split('.').next());
        let mut depth = 0;
        for number in numbers {
            match number.parse::<usize>() {
                Ok(n) if n < self.file.tensors.len() => depth = depth.max(n + 1),
                _ => {
                    return Err(self.problem(
                        &format!("blocks.{number}"),
                        "this block",
                        "blocks.0, blocks.1, ...",
                    ));
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
        let hidden = match self.shape(&name("mlp.fc1.weight"))? {
            &[hidden, found] if found == width && hidden > 0 => hidden,
            other => {
                let expected = format!("[hidden, {width}]");
                return Err(self.problem(
                    &name("mlp.fc1.weight"),
                    format!("shape {other:?}"),
                    expected,
                ));
            }
        };
        Ok(Block {
            norm1: self.norm(&name("norm1"), width)?,
            qkv: self.linear(&name("attn.qkv"), [width, 3 * width])?,
            projection: self.linear(&name("attn.proj"), [width, width])?,
            norm2: self.norm(&name("norm2"), width)?,
            fc1: self.linear(&name("mlp.fc1"), [width, hidden])?,
            fc2: self.linear(&name("mlp.fc2"), [hidden, width])?,
        })
    }

    fn linear(&self, name: &str, [input, output]: [usize; 2]) -> Result<Linear> {
        let weights = self.values(&format!("{name}.weight"), &[output, input])?;
        Ok(Linear::new(
            &weights,
            self.values(&format!("{name}.bias"), &[output])?,
        ))
    }

    fn norm(&self, name: &str, width: usize) -> Result<LayerNorm> {
        Ok(LayerNorm {
            weight: self.values(&format!("{name}.weight"), &[width])?,
            bias: self.values(&format!("{name}.bias"), &[width])?,
        })
    }
}
