//! DINO's vision transformer (Caron et al. 2021; Dosovitskiy et al. 2020), for inference.
//!
//! The network cuts an image into patches, each a token of `width` numbers. A class token sees the whole image. Each quarter of the
//! blocks (up to block 3, 6, 9 and 12 of the published 12) gives one scale of features: the patch tokens after it, each with that
//! block's class token appended. The paper takes "outputs of 4 transformer blocks", "concatenated with the expanded global feature
//! tensor". It says neither which blocks, nor which tensor, nor whether the final layer normalisation is applied. We apply it to
//! each of the four: raw block outputs grow with depth, and some channels would drown the rest in the PCA.
//!
//! All four scales have one resolution, one cell for each patch. Cells keep the stride of a patch whatever the image's size: the
//! image's border pixels fill up the last column and row. The official code drops what does not fill a patch. Both agree where
//! sizes are multiples of the patch.

mod load;
mod position;

pub use super::transformer::HEAD;

use super::transformer::{Block, Style};
use super::{FeatureMap, SCALES, Steps, normalized};
use crate::error::Result;
use burn::module::{Module, Param};
use burn::nn::{LayerNorm, Linear};
use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;
use position::PositionEmbedding;

/// Part of cache keys. Raise it when the arithmetic changes.
pub const VERSION: &str = "dino-2";

/// The network. Its dimensions are those of its weights, see [`Vit::load`].
#[derive(Module, Debug)]
pub struct Vit {
    patch: usize,
    /// From the pixels of a patch, `[3 * patch * patch, width]`.
    embedding: Linear,
    /// `[1, 1, width]`.
    class_token: Param<Tensor<3>>,
    positions: PositionEmbedding,
    blocks: Vec<Block>,
    norm: LayerNorm,
}

impl Vit {
    /// Length of a token.
    pub fn width(&self) -> usize {
        self.class_token.dims()[2]
    }

    /// Side of a patch, pixels.
    pub fn patch(&self) -> usize {
        self.patch
    }

    /// Number of blocks.
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// Blocks, counted from 1, whose outputs are the scales: the ends of the quarters of the depth, rounded up.
    pub fn taps(&self) -> [usize; SCALES] {
        std::array::from_fn(|n| (self.depth() * (n + 1)).div_ceil(SCALES))
    }

    /// The tokens of normalised images `[B, 3, H, W]`, `[B, 1 + patches, width]`: before the first block, then after each.
    /// The class token comes first, then the patches row by row.
    pub fn forward(&self, images: Tensor<4>) -> Vec<Tensor<3>> {
        let mut tokens = Vec::with_capacity(self.depth() + 1);
        let mut x = self.embed(images);
        for block in &self.blocks {
            tokens.push(x.clone());
            x = block.forward(x, Style::default());
        }
        tokens.push(x);
        tokens
    }

    /// The final layer normalisation, token by token.
    pub fn normalized(&self, tokens: Tensor<3>) -> Tensor<3> {
        self.norm.forward(tokens)
    }

    /// Patches times the embedding, plus position embeddings.
    fn embed(&self, images: Tensor<4>) -> Tensor<3> {
        let [batch, _, height, width] = images.dims();
        let p = self.patch;
        let d = self.width();
        let (rows, columns) = (height.div_ceil(p), width.div_ceil(p));
        let padding = (0, columns * p - width, 0, rows * p - height);
        let pixels = images
            .pad(padding, PadMode::Edge)
            .reshape([batch, 3, rows, p, columns, p])
            .permute([0, 2, 4, 1, 3, 5])
            .reshape([batch, rows * columns, 3 * p * p]);
        let class = self.class_token.val().expand([batch, 1, d]);
        let tokens = Tensor::cat(vec![class, self.embedding.forward(pixels)], 1);
        tokens + self.positions.over(rows, columns).unsqueeze()
    }

    /// The four scales of an image at its own resolution. Each has `2 * width` channels: those of the patch token, then those
    /// of the class token.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for an image without pixels; [`crate::Error::NonFinite`] when an activation is not finite;
    /// [`crate::Error::Device`] when the device fails.
    pub fn maps(&self, image: &image::RgbImage) -> Result<Vec<FeatureMap>> {
        let tokens = self.forward(normalized(image, &self.class_token.device())?);
        let rows = (image.height() as usize).div_ceil(self.patch);
        let taps = self.taps().into_iter();
        let maps = taps.map(|block| {
            let tokens = self.normalized(tokens[block].clone());
            self.map(tokens, rows, &format!("DINO block {block}"))
        });
        maps.collect()
    }

    fn map(&self, tokens: Tensor<3>, rows: usize, name: &str) -> Result<FeatureMap> {
        let [_, count, width] = tokens.dims();
        let class = tokens.clone().narrow(1, 0, 1).expand([1, count - 1, width]);
        let patches = tokens.narrow(1, 1, count - 1);
        let cells = Tensor::cat(vec![patches, class], 2);
        let cells = cells.reshape([1, rows, (count - 1) / rows, 2 * width]);
        let stride = self.patch as f64;
        let steps = Steps::new(stride, 0.5 * stride);
        FeatureMap::from_tensor(cells, Some(steps), name)
    }
}
