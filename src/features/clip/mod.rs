//! CLIP's text encoder (Radford et al. 2021), for inference: texts as vectors that image features of CLIP point along.

mod load;
mod tokens;

pub use self::tokens::Tokenizer;

use super::Activation;
use super::transformer::{Block, Style};
use crate::backend::check_finite;
use crate::backend::device::read;
use crate::error::{Result, ensure};
use burn::module::{Module, Param};
use burn::nn::LayerNorm;
use burn::tensor::{Int, Tensor, TensorData};

/// The network. Its dimensions are those of its weights, see [`TextEncoder::load`].
#[derive(Module, Debug)]
pub struct TextEncoder {
    /// `[vocabulary, width]`.
    tokens: Param<Tensor<2>>,
    /// `[most tokens, width]`.
    positions: Param<Tensor<2>>,
    blocks: Vec<Block>,
    norm: LayerNorm,
    /// `[width, channels]`.
    projection: Param<Tensor<2>>,
}

impl TextEncoder {
    /// Number of words and parts of words that it knows.
    pub fn vocabulary(&self) -> usize {
        self.tokens.dims()[0]
    }

    /// Tokens of a text, at most.
    pub fn most_tokens(&self) -> usize {
        self.positions.dims()[0]
    }

    /// Length of an embedding.
    pub fn channels(&self) -> usize {
        self.projection.dims()[1]
    }

    /// The embedding of a text, `[channels]`, of any length: that of its last token, which marks its end. Published code pads texts;
    /// tokens see only those before them, so that gives the same.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for a text without tokens, with more than [`Self::most_tokens`] or with one outside the
    /// vocabulary; [`crate::Error::NonFinite`] for weights under which an activation is not finite; [`crate::Error::Device`] when the
    /// device fails.
    pub fn embedding(&self, tokens: &[u32], activation: Activation) -> Result<Vec<f32>> {
        let count = tokens.len();
        let most = self.most_tokens();
        ensure!((1..=most).contains(&count), argument "text"; found "{count} tokens"; expected "1 to {most}, its two ends included";
            help "give a shorter text");
        let vocabulary = self.vocabulary();
        let last = tokens.iter().copied().max().unwrap_or_default();
        ensure!((last as usize) < vocabulary, argument "text"; found "token {last}"; expected "tokens below {vocabulary}";
            help "give weights that were trained with the vocabulary of CLIP");
        let places = tokens.iter().map(|&token| i64::from(token)).collect();
        let places = TensorData::new::<i64, _>(places, [count]);
        let places = Tensor::<1, Int>::from_data(places, &self.tokens.device());
        let positions = self.positions.val().narrow(0, 0, count);
        let style = Style {
            activation,
            is_causal: true,
        };
        let embedded = (self.tokens.val().select(0, places) + positions).unsqueeze();
        let seen = |x, block: &Block| block.forward(x, style);
        let x: Tensor<3> = self.blocks.iter().fold(embedded, seen);
        let end = self.norm.forward(x.narrow(1, count - 1, 1));
        let embedding = end.squeeze_dim::<2>(0).matmul(self.projection.val());
        let embedding = read("a text embedding", embedding)?;
        check_finite("text embedding", &embedding, embedding.len())?;
        Ok(embedding)
    }
}
