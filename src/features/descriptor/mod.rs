//! The built-in multi-scale image descriptor: hand-made statistics, no weights, no learning, no position.
//!
//! Every pixel gets responses (`colour`: moments and soft histograms in several colour spaces; `texture`: gradient orientations,
//! blobs and local binary patterns on a pyramid of four octaves). Scale n of the output is the Gaussian mean of these responses
//! over a window that grows from local to global. Second moments become standard deviations. Histograms and energies are
//! compressed. The colour contrast against a wider surround is appended.
//!
//! | scale | grid step (pixels) | window sigma (pixels) | surround sigma (pixels) |
//! |---|---|---|---|
//! | 1 | 4 | 3 | 8 |
//! | 2 | 4 | 8 | 20 |
//! | 3 | 8 | 20 | 48 |
//! | 4 | 16 | 48 | 112 |

mod colour;
mod pooling;
mod texture;

use super::FeatureMap;
use colour::COLOUR;
use texture::TEXTURE;

/// Values per cell, at every scale.
pub const CHANNELS: usize = COLOUR + TEXTURE + colour::MEANS;

/// Part of cache keys; raise it when the arithmetic changes.
pub const VERSION: &str = "descriptor-1";

/// Grid step over the finest grid and window sigma, both in cells of 4 pixels.
const SCALES: [(usize, f64); 4] = [(1, 0.75), (1, 2.0), (2, 5.0), (4, 12.0)];

/// The maps of an image at the first `scales` scales, fine to coarse, [`CHANNELS`] values per cell.
pub fn describe(image: &image::RgbImage, scales: usize) -> Vec<FeatureMap> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (w, h) = (width.div_ceil(4).max(1), height.div_ceil(4).max(1));
    if width == 0 || height == 0 {
        return vec![FeatureMap::zeros(0, 0, CHANNELS); scales];
    }
    let colours = colour::responses(image);
    let luma = colour::luma(image);
    let colours = colours.resized(h, w);
    let textures = texture::responses(&luma, h, w);
    let cells = pooling::join(&colours, &textures);
    let maps = SCALES.iter().take(scales).map(|&(step, sigma)| {
        let (h, w) = (h.div_ceil(step), w.div_ceil(step));
        let sampled = cells.resized(h, w);
        let sigma = sigma / step as f64;
        let window = pooling::gaussian(&sampled, sigma);
        let means = pooling::first_channels(&sampled, colour::MEANS);
        let surround = pooling::gaussian(&means, 2.5 * sigma);
        finish(&window, &surround)
    });
    maps.collect()
}

/// Pooled responses to descriptor values of about unit spread.
fn finish(window: &FeatureMap, surround: &FeatureMap) -> FeatureMap {
    let mut out = FeatureMap::zeros(window.height, window.width, CHANNELS);
    let cells = window
        .data
        .chunks_exact(window.channels)
        .zip(surround.data.chunks_exact(surround.channels));
    for (out, (cell, around)) in out.data.chunks_exact_mut(CHANNELS).zip(cells) {
        let (colours, textures) = cell.split_at(COLOUR);
        let (head, contrast) = out.split_at_mut(COLOUR + TEXTURE);
        colour::finish(colours, &mut head[..COLOUR]);
        texture::finish(textures, &mut head[COLOUR..]);
        for ((o, &a), &b) in contrast.iter_mut().zip(colours).zip(around) {
            *o = 2.0 * (a - b);
        }
    }
    out
}
