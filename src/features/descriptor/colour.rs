//! Colour responses of single pixels and their compression after pooling.

use super::FeatureMap;
use rayon::prelude::*;

/// Channels that are plain means: L, a, b; chroma times cosine and sine of the hue; normalised red and green; saturation.
pub const MEANS: usize = 8;
/// Second moments of L, a, b.
const SQUARES: usize = 3;
/// Soft histogram of the hue, weighted by chroma.
const HUES: usize = 8;
/// Soft histogram of the lightness.
const LIGHTS: usize = 6;
/// All colour channels.
pub const COLOUR: usize = MEANS + SQUARES + HUES + LIGHTS;

/// Luma of each pixel, 0..1 (Rec. 601 weights on sRGB values), one channel.
pub fn luma(image: &image::RgbImage) -> FeatureMap {
    let data = image.pixels().map(|p| {
        (0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])) / 255.0
    });
    FeatureMap {
        height: image.height() as usize,
        width: image.width() as usize,
        channels: 1,
        data: data.collect(),
        steps: None,
    }
}

/// Responses of every pixel, `[H, W, COLOUR]`.
pub fn responses(image: &image::RgbImage) -> FeatureMap {
    let linear: Vec<f32> = (0..=255_u8)
        .map(|v| srgb_to_linear(f32::from(v) / 255.0))
        .collect();
    let mut out = FeatureMap::zeros(image.height() as usize, image.width() as usize, COLOUR);
    out.data
        .par_chunks_exact_mut(COLOUR)
        .zip(image.as_raw().par_chunks_exact(3))
        .with_min_len(1024)
        .for_each(|(out, rgb)| {
            let [l, a, b] = lab([
                linear[rgb[0] as usize],
                linear[rgb[1] as usize],
                linear[rgb[2] as usize],
            ]);
            let [r, g, bl] = [0, 1, 2].map(|i| f32::from(rgb[i]) / 255.0);
            let sum = r + g + bl + 0.05;
            let high = r.max(g).max(bl);
            let low = r.min(g).min(bl);
            let (hue, chroma) = hue(r, g, bl);
            let (sin, cos) = (hue * std::f32::consts::TAU / HUES as f32).sin_cos();
            out[..MEANS].copy_from_slice(&[
                l,
                a,
                b,
                chroma * cos,
                chroma * sin,
                r / sum,
                g / sum,
                (high - low) / (high + 0.05),
            ]);
            for (o, x) in out[MEANS..MEANS + SQUARES].iter_mut().zip([l, a, b]) {
                *o = x * x;
            }
            let (hues, lights) = out[MEANS + SQUARES..].split_at_mut(HUES);
            let bin = hue as usize % HUES;
            let share = hue.fract();
            hues[bin] = chroma * (1.0 - share);
            hues[(bin + 1) % HUES] = chroma * share;
            let light = (l.clamp(0.0, 1.0) * (LIGHTS - 1) as f32).min((LIGHTS - 1) as f32 - 1e-4);
            lights[light as usize] = 1.0 - light.fract();
            lights[light as usize + 1] = light.fract();
        });
    out
}

/// Pooled responses to descriptor values.
pub fn finish(pooled: &[f32], out: &mut [f32]) {
    for (o, &x) in out[..MEANS].iter_mut().zip(pooled) {
        *o = 2.0 * x;
    }
    for k in 0..SQUARES {
        let variance = (pooled[MEANS + k] - pooled[k] * pooled[k]).max(0.0);
        out[MEANS + k] = 4.0 * (variance + 1e-5).sqrt();
    }
    for (o, &x) in out[MEANS + SQUARES..]
        .iter_mut()
        .zip(&pooled[MEANS + SQUARES..])
    {
        *o = (x.max(0.0) + 1e-4).sqrt();
    }
}

fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// CIE Lab (D65) of linear sRGB; L over 100, a and b over 50.
fn lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let x = (0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b) / 0.950_47;
    let y = 0.212_672_9 * r + 0.715_152_2 * g + 0.072_175 * b;
    let z = (0.019_333_9 * r + 0.119_192 * g + 0.950_304_1 * b) / 1.088_83;
    let f = |t: f32| {
        if t > 0.008_856 {
            t.cbrt()
        } else {
            7.787 * t + 16.0 / 116.0
        }
    };
    let (fx, fy, fz) = (f(x), f(y), f(z));
    [1.16 * fy - 0.16, 10.0 * (fx - fy), 4.0 * (fy - fz)]
}

/// Hue in bins, `0..HUES`, and chroma, 0..1.
fn hue(r: f32, g: f32, b: f32) -> (f32, f32) {
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let chroma = high - low;
    if chroma <= 0.0 {
        return (0.0, 0.0);
    }
    let sextant = if high == r {
        ((g - b) / chroma).rem_euclid(6.0)
    } else if high == g {
        (b - r) / chroma + 2.0
    } else {
        (r - g) / chroma + 4.0
    };
    (
        (sextant * HUES as f32 / 6.0).min(HUES as f32 - 1e-4),
        chroma,
    )
}
