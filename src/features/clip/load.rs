//! Text encoders from weight files, with the key names of Hugging Face, or with those of OpenAI and OpenCLIP.

use super::TextEncoder;
use crate::error::{Result, bail};
use crate::features::Activation;
use crate::features::transformer::{Block, HEAD, Weights, linear};
use crate::files;
use crate::weights::WeightFile;
use burn::module::Param;
use burn::tensor::{Device, Tensor};
use serde_json::Value;
use std::path::Path;

/// Epsilon of the layer normalisations.
const EPSILON: f64 = 1e-5;

const NETWORK: &str = "a CLIP text encoder (keys `text_model.*` and `text_projection.weight`, or `token_embedding.weight`, \
    `transformer.resblocks.N.*` and `text_projection`)";

/// How a file names its tensors.
struct Names {
    tokens: &'static str,
    positions: &'static str,
    /// What precedes the number of a block.
    blocks: &'static str,
    norm1: &'static str,
    attention: &'static str,
    /// The matrices of an attention: one for queries, keys and values, or one for each.
    qkv: &'static [&'static str],
    /// What follows their names: of the weights, of the biases.
    ends: [&'static str; 2],
    norm2: &'static str,
    fc1: &'static str,
    fc2: &'static str,
    norm: &'static str,
    projection: &'static str,
    /// Whether the projection is stored as `[channels, width]`.
    is_projection_transposed: bool,
}

const HUGGING_FACE: Names = Names {
    tokens: "text_model.embeddings.token_embedding.weight",
    positions: "text_model.embeddings.position_embedding.weight",
    blocks: "text_model.encoder.layers.",
    norm1: "layer_norm1",
    attention: "self_attn",
    qkv: &["q_proj", "k_proj", "v_proj"],
    ends: [".weight", ".bias"],
    norm2: "layer_norm2",
    fc1: "mlp.fc1",
    fc2: "mlp.fc2",
    norm: "text_model.final_layer_norm",
    projection: "text_projection.weight",
    is_projection_transposed: true,
};

const OPENAI: Names = Names {
    tokens: "token_embedding.weight",
    positions: "positional_embedding",
    blocks: "transformer.resblocks.",
    norm1: "ln_1",
    attention: "attn",
    qkv: &["in_proj"],
    ends: ["_weight", "_bias"],
    norm2: "ln_2",
    fc1: "mlp.c_fc",
    fc2: "mlp.c_proj",
    norm: "ln_final",
    projection: "text_projection",
    is_projection_transposed: false,
};

impl TextEncoder {
    /// The nonlinearity that the `config.json` of Hugging Face beside `weights` names; `None` without such a file.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] for other content.
    pub fn activation_beside(weights: &Path) -> Result<Option<Activation>> {
        const FORM: &str = "the configuration of a CLIP model";
        let path = weights.with_file_name("config.json");
        if !path.is_file() {
            return Ok(None);
        }
        let content: Value = serde_json::from_str(&files::text(&path)?)
            .map_err(|e| files::json_error(&path, &e, FORM))?;
        let places = ["/text_config/hidden_act", "/hidden_act"];
        let mut named = places.iter().filter_map(|place| content.pointer(place));
        // Hugging Face leaves out what is its default.
        let named = named.next().map_or(Some("quick_gelu"), Value::as_str);
        match named {
            Some("quick_gelu") => Ok(Some(Activation::QuickGelu)),
            Some("gelu") => Ok(Some(Activation::Gelu)),
            other => {
                bail!(path, "hidden_act"; found "{}", other.unwrap_or("no text"); expected "quick_gelu or gelu";
                help "name one of them, if it is a model of CLIP")
            }
        }
    }

    /// Reads weights from a `.safetensors` file, or from any other file as a PyTorch checkpoint. Those of the image encoder are
    /// ignored. All extents are those of the tensors; there is a head for every [`HEAD`] channels.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file cannot be read; [`crate::Error::Input`] when it is damaged, when tensors are missing, have
    /// shapes that do not go together, or hold a value that is not finite.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        let needed =
            |name: &str| !name.starts_with("vision_model.") && !name.starts_with("visual.");
        let file = WeightFile::open_where(path, needed)?.of_network(NETWORK);
        let is_openai = file.tensors.contains_key(OPENAI.tokens);
        let names = if is_openai { OPENAI } else { HUGGING_FACE };
        let weights = Weights {
            file,
            device,
            epsilon: EPSILON,
        };
        let (vocabulary, width) = extents(&weights, names.tokens, None)?;
        let (positions, _) = extents(&weights, names.positions, Some(width))?;
        let projection = names.projection(&weights, width)?;
        let blocks = 0..weights.depth(names.blocks)?;
        let blocks = blocks.map(|n| names.block(&weights, n, width));
        Ok(Self {
            tokens: weights.parameter(names.tokens, [vocabulary, width])?,
            positions: weights.parameter(names.positions, [positions, width])?,
            blocks: blocks.collect::<Result<_>>()?,
            norm: weights.norm(names.norm, width)?,
            projection: Param::from_tensor(projection),
        })
    }
}

/// Rows and columns of a table of vectors, of `width` columns if that is known.
fn extents(weights: &Weights<'_>, name: &str, width: Option<usize>) -> Result<(usize, usize)> {
    let expected = match width {
        Some(width) => format!("[rows, {width}]"),
        None => format!("[rows, width], width a multiple of {HEAD}"),
    };
    weights.shape(name, &expected, |shape| match *shape {
        [rows, columns] => {
            let fits = columns % HEAD == 0 && width.is_none_or(|width| width == columns);
            (fits && rows > 0 && columns > 0).then_some((rows, columns))
        }
        _ => None,
    })
}

impl Names {
    /// `[width, channels]`.
    fn projection(&self, weights: &Weights<'_>, width: usize) -> Result<Tensor<2>> {
        let is_transposed = self.is_projection_transposed;
        let order = if is_transposed {
            "[channels, width]"
        } else {
            "[width, channels]"
        };
        let expected = format!("{order}, width {width}");
        let shape = weights.shape(self.projection, &expected, |shape| match *shape {
            [channels, w] if is_transposed && w == width && channels > 0 => Some([channels, w]),
            [w, channels] if !is_transposed && w == width && channels > 0 => Some([w, channels]),
            _ => None,
        })?;
        let values: Tensor<2> = weights.tensor(self.projection, &shape)?.reshape(shape);
        Ok(if is_transposed {
            values.transpose()
        } else {
            values
        })
    }

    fn block(&self, weights: &Weights<'_>, n: usize, width: usize) -> Result<Block> {
        let name = |part: &str| format!("{}{n}.{part}", self.blocks);
        let attention = |part: &str| name(&format!("{}.{part}", self.attention));
        let hidden = weights.outputs(&name(self.fc1), width)?;
        let rows = 3 * width / self.qkv.len();
        let [weight, bias] = self.ends;
        let joined = |end: &str, shape: &[usize]| {
            let tensor = |kind: &&str| weights.tensor(&attention(&format!("{kind}{end}")), shape);
            let tensors = self.qkv.iter().map(tensor);
            Ok(Tensor::cat(tensors.collect::<Result<_>>()?, 0))
        };
        let qkv = joined(weight, &[rows, width])?.reshape([3 * width, width]);
        Ok(Block {
            norm1: weights.norm(&name(self.norm1), width)?,
            qkv: linear(qkv, joined(bias, &[rows])?),
            projection: weights.linear(&attention("out_proj"), &[width, width])?,
            norm2: weights.norm(&name(self.norm2), width)?,
            fc1: weights.linear(&name(self.fc1), &[hidden, width])?,
            fc2: weights.linear(&name(self.fc2), &[width, hidden])?,
        })
    }
}
