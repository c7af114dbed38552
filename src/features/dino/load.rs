//! DINO weights from `.safetensors` or PyTorch files, with the key names of facebookresearch/dino.
//!
//! Published backbones have the keys at the top. Full checkpoints hold two networks, under `teacher` and `student`, and
//! prefixes `module.` and `backbone.`. The teacher gives DINO's published results, so we take it.

use super::position::PositionEmbedding;
use super::{Block, HEAD, Vit};
use crate::error::Result;
use crate::features::transformer::Weights;
use crate::weights::WeightFile;
use burn::module::Param;
use burn::tensor::Device;
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
        let weights = Weights {
            file,
            device,
            epsilon: EPSILON,
        };
        weights.check_kind()?;
        let (width, patch) = weights.patch()?;
        let side = weights.side(width)?;
        let blocks = (0..weights.depth("blocks.")?).map(|n| weights.block(n, width));
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

impl Weights<'_> {
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

    fn block(&self, n: usize, width: usize) -> Result<Block> {
        let name = |part: &str| format!("blocks.{n}.{part}");
        let hidden = self.outputs(&name("mlp.fc1"), width)?;
        Ok(Block {
            norm1: self.norm(&name("norm1"), width)?,
            qkv: self.linear(&name("attn.qkv"), &[3 * width, width])?,
            projection: self.linear(&name("attn.proj"), &[width, width])?,
            norm2: self.norm(&name("norm2"), width)?,
            fc1: self.linear(&name("mlp.fc1"), &[hidden, width])?,
            fc2: self.linear(&name("mlp.fc2"), &[width, hidden])?,
        })
    }
}
