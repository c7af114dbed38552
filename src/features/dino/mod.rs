//! DINO's vision transformer (Caron et al. 2021; Dosovitskiy et al. 2020), inference on plain slices.
//!
//! An image is cut into patches, each a token of `width` numbers; a class token sees the whole image. After every quarter
//! of the blocks (3, 6, 9 and 12 of the published 12) the patch tokens, each with that block's class token appended, are
//! one scale of features. The paper takes "outputs of 4 transformer blocks", "concatenated with the expanded global feature
//! tensor"; it says neither which blocks, nor which tensor, nor whether the final layer normalisation is applied.
//! We apply it to each of the four ([`Vit::with_final_norm`]): raw block outputs grow with depth, and
//! some channels would drown the rest in the PCA.
//!
//! All four scales have one resolution, a cell a patch. Cells keep the stride of a patch whatever the image's size; the last
//! column and row are filled up with the image's own border pixels. The official code drops what does
//! not fill a patch. Where sizes are multiples of the patch, both agree.
//!
//! A call runs on all threads of the pool. Attention is computed for a few queries at a time, so that memory grows with
//! the number of tokens, not with its square.

mod attention;
mod kernels;
mod layers;
mod load;
mod position;

use super::mobilenet::{MEAN, STD};
use super::{FeatureMap, SCALES, Steps};
use crate::error::{Error, Result};
use layers::{Block, LayerNorm, Linear, ROWS};
use position::PositionEmbedding;
use rayon::prelude::*;

/// Part of cache keys; raise it when the arithmetic changes.
pub const VERSION: &str = "dino-1";

/// Channels of an attention head in every DINO ViT; there are `width / 64` heads.
pub const HEAD: usize = 64;

/// Queries attended at once, per thread: 256 rows of scores fit the caches of common processors for most images.
const QUERIES: usize = 256;

/// The network. Its dimensions are those of its weights, see [`Vit::load`].
#[derive(Clone, Debug)]
pub struct Vit {
    width: usize,
    patch: usize,
    /// Patch embedding, `[width, 3 * patch * patch]`.
    embedding: Linear,
    /// Class token, `[width]`.
    class_token: Vec<f32>,
    positions: PositionEmbedding,
    blocks: Vec<Block>,
    norm: LayerNorm,
    final_norm: bool,
    queries: usize,
}

/// Tokens of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tokens {
    /// Patches down.
    pub rows: usize,
    /// Patches across.
    pub columns: usize,
    /// `[1 + rows * columns, width]`: the class token, then the patches row by row.
    pub values: Vec<f32>,
}

impl Vit {
    /// Length of a token.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Side of a patch, pixels.
    pub fn patch(&self) -> usize {
        self.patch
    }

    /// Number of blocks.
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// Attention heads, 64 channels each.
    pub fn heads(&self) -> usize {
        self.width / HEAD
    }

    /// Blocks, counted from 1, whose outputs are the scales: the ends of the quarters of the depth, rounded up.
    pub fn taps(&self) -> [usize; SCALES] {
        std::array::from_fn(|n| (self.depth() * (n + 1)).div_ceil(SCALES))
    }

    /// Whether feature maps take the final layer normalisation of each tapped block's output (they do by default).
    pub fn with_final_norm(mut self, apply: bool) -> Self {
        self.final_norm = apply;
        self
    }

    /// Attention for `queries` tokens at a time (at least 1); the result does not depend on it beyond rounding, memory does:
    /// a thread holds `4 * queries * tokens` bytes of scores.
    pub fn with_query_chunk(mut self, queries: usize) -> Self {
        self.queries = queries.max(1);
        self
    }

    /// Runs the network on planes `[3, height, width]`, normalised by [`MEAN`] and [`STD`]. `visit` is shown the tokens
    /// before the first block as 0, and after block n as n, up to block `last`. Returns the last ones.
    ///
    /// # Errors
    /// [`Error::Argument`] when the planes have another length or no pixel; [`Error::NonFinite`] when attention overflows;
    /// what `visit` returns.
    pub fn forward(
        &self,
        planes: &[f32],
        [height, width]: [usize; 2],
        last: usize,
        visit: &mut dyn FnMut(usize, &Tokens) -> Result<()>,
    ) -> Result<Tokens> {
        if planes.len() != 3 * height * width || planes.is_empty() {
            let (found, expected) = (
                format!("{} values", planes.len()),
                format!("3 x {height} x {width}, not 0"),
            );
            return Err(Error::argument(
                "image of DINO",
                found,
                expected,
                "give three planes",
            ));
        }
        let mut tokens = self.embed(planes, height, width);
        visit(0, &tokens)?;
        for (n, block) in (1..).zip(self.blocks.iter().take(last)) {
            block.forward(&mut tokens.values, self.width, self.queries, n)?;
            visit(n, &tokens)?;
        }
        Ok(tokens)
    }

    /// The final layer normalisation, token by token.
    pub fn normalised(&self, tokens: &Tokens) -> Tokens {
        let mut values = vec![0.0; tokens.values.len()];
        values
            .par_chunks_mut(ROWS * self.width)
            .zip(tokens.values.par_chunks(ROWS * self.width))
            .for_each(|(out, x)| self.norm.apply(x, out));
        Tokens { values, ..*tokens }
    }

    /// Patches times the embedding, plus position embeddings.
    fn embed(&self, planes: &[f32], height: usize, width: usize) -> Tokens {
        let (d, p) = (self.width, self.patch);
        let (rows, columns) = (height.div_ceil(p), width.div_ceil(p));
        let mut values = self.positions.over(rows, columns, d);
        let (class, patches) = values.split_at_mut(d);
        class
            .iter_mut()
            .zip(&self.class_token)
            .for_each(|(x, c)| *x += c);
        patches
            .par_chunks_mut(ROWS * d)
            .enumerate()
            .for_each(|(chunk, out)| {
                let mut pixels = Vec::with_capacity(out.len() / d * 3 * p * p);
                for token in (chunk * ROWS..).take(out.len() / d) {
                    let (top, left) = (token / columns * p, token % columns * p);
                    for (plane, y) in planes
                        .chunks_exact(height * width)
                        .flat_map(|c| (0..p).map(move |y| (c, y)))
                    {
                        // Beyond the image its border pixels go on.
                        let row = &plane[(top + y).min(height - 1) * width..][..width];
                        let whole = &row[left..(left + p).min(width)];
                        pixels.extend_from_slice(whole);
                        pixels.extend(std::iter::repeat_n(row[width - 1], p - whole.len()));
                    }
                }
                self.embedding.add_to(&pixels, out);
            });
        Tokens {
            rows,
            columns,
            values,
        }
    }

    /// The four scales of an image at its own resolution; normalised here. Each has `2 * width` channels: those
    /// of the patch token, then those of the class token.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when an activation is not finite; [`Error::Argument`] for an image without pixels.
    pub fn maps(&self, image: &image::RgbImage) -> Result<[FeatureMap; SCALES]> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut planes = Vec::with_capacity(3 * width * height);
        for (c, (mean, std)) in MEAN.iter().zip(STD).enumerate() {
            let channel = image.as_raw().iter().skip(c).step_by(3);
            planes.extend(channel.map(|&x| (f32::from(x) / 255.0 - mean) / std));
        }
        let taps = self.taps();
        let mut maps: [FeatureMap; SCALES] = Default::default();
        self.forward(
            &planes,
            [height, width],
            self.depth(),
            &mut |block, tokens| {
                for (scale, _) in taps.iter().enumerate().filter(|(_, tap)| **tap == block) {
                    maps[scale] = match self.final_norm {
                        true => self.map(&self.normalised(tokens)),
                        false => self.map(tokens),
                    };
                    maps[scale].check(&format!("DINO block {block}"))?;
                }
                Ok(())
            },
        )?;
        Ok(maps)
    }

    fn map(&self, tokens: &Tokens) -> FeatureMap {
        let (class, patches) = tokens.values.split_at(self.width);
        let mut data = Vec::with_capacity(2 * patches.len());
        for patch in patches.chunks_exact(self.width) {
            data.extend_from_slice(patch);
            data.extend_from_slice(class);
        }
        let stride = self.patch as f64;
        let steps = Some(Steps {
            stride,
            offset: 0.5 * stride,
        });
        FeatureMap {
            height: tokens.rows,
            width: tokens.columns,
            channels: 2 * self.width,
            data,
            steps,
        }
    }
}
