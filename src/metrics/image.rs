//! PSNR and SSIM of `[H, W, 3]` images in 0..1.

use super::mean;
use crate::data::View;
use crate::data::mask::Mask;
use crate::error::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// PSNR of images that agree exactly (mean squared error below 1e-10), dB.
pub const PSNR_CAP: f64 = 100.0;

/// PSNR and SSIM of one image, or their means over images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageScores {
    /// Peak signal-to-noise ratio, dB.
    pub psnr: Option<f64>,
    /// Structural similarity, at most 1.
    pub ssim: Option<f64>,
}

impl ImageScores {
    /// Scores of a render of `view` (`[height, width, 3]`) against its photo, over the pixels that its mask uses: PSNR of those
    /// pixels, SSIM over the windows that hold no other pixel. See [`psnr`] and [`ssim`] for `None`.
    ///
    /// # Errors
    /// As [`crate::data::Photo::pixels`]; [`crate::Error::Argument`] for a mask of a different size than the photo.
    pub fn of_view(image: &[f32], view: &View) -> Result<Self> {
        view.check_mask()?;
        let photo = view.rgb()?;
        let mask = view.mask.as_ref();
        let size = [view.image.width(), view.image.height(), 3];
        Ok(Self {
            psnr: masked_psnr(image, &photo, mask),
            ssim: ssim(image, &photo, size, mask),
        })
    }

    /// Means of the per-image values that exist.
    pub fn mean(scores: &[Self]) -> Self {
        Self {
            psnr: mean(scores.iter().map(|s| s.psnr)),
            ssim: mean(scores.iter().map(|s| s.ssim)),
        }
    }
}

/// -10 log10 of the mean squared error of values clamped to 0..1, not quantised; at most [`PSNR_CAP`].
///
/// `None` when the images are empty, differ in length, or a value is NaN.
pub fn psnr(image: &[f32], truth: &[f32]) -> Option<f64> {
    if image.is_empty() || image.len() != truth.len() {
        return None;
    }
    // Sums of blocks, added in order: the same bits at any number of threads, and little rounding.
    let blocks: Vec<f64> = image
        .par_chunks(4_096)
        .zip(truth.par_chunks(4_096))
        .map(|(a, b)| {
            a.iter()
                .zip(b)
                .map(|(&a, &b)| (unit(a) - unit(b)).powi(2))
                .sum()
        })
        .collect();
    let mse = blocks.iter().sum::<f64>() / image.len() as f64;
    (!mse.is_nan()).then(|| (-10.0 * mse.max(1e-10).log10()).min(PSNR_CAP))
}

/// [`psnr`] of `[H, W, 3]` images over the pixels that `mask` uses.
pub(crate) fn masked_psnr(image: &[f32], truth: &[f32], mask: Option<&Mask>) -> Option<f64> {
    match mask {
        Some(mask) => psnr(&mask.used(image, 3), &mask.used(truth, 3)),
        None => psnr(image, truth),
    }
}

/// Values outside 0..1 cannot be shown; NaN stays NaN.
fn unit(v: f32) -> f64 {
    f64::from(v.clamp(0.0, 1.0))
}

/// Half the width of the SSIM window.
const RADIUS: usize = 5;
/// Standard deviation of the SSIM window, pixels.
const SIGMA: f64 = 1.5;

/// Mean structural similarity of `[height, width, channels]` images clamped to 0..1 (Wang et al. 2004).
///
/// Gaussian window 11x11, sigma 1.5, population covariance, K1 = 0.01, K2 = 0.03, range 1. The border of 5 pixels is left out.
/// Channels are averaged. The same as scikit-image's `structural_similarity(gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False, data_range=1)`. All arithmetic in f64.
///
/// Only windows whose pixels are all used by `mask` count, if there is one.
///
/// `None` when a side is shorter than 11 pixels, the lengths do not fit, there are no channels, a value is NaN, no window counts, or
/// the mask has another size.
pub fn ssim(
    image: &[f32],
    truth: &[f32],
    [width, height, channels]: [usize; 3],
    mask: Option<&Mask>,
) -> Option<f64> {
    let side = 2 * RADIUS + 1;
    let fits = width.checked_mul(height)?.checked_mul(channels)? == image.len()
        && image.len() == truth.len();
    if !fits || channels == 0 || width < side || height < side {
        return None;
    }
    if mask.is_some_and(|mask| (mask.width(), mask.height()) != (width, height)) {
        return None;
    }
    let window = window();
    let rows: Vec<(f64, usize)> = (0..height + 1 - side)
        .into_par_iter()
        .map(|y| {
            let whole = mask.map(|mask| whole_windows(mask, y));
            ssim_row(image, truth, width, channels, y, &window, whole.as_deref())
        })
        .collect();
    let count: usize = rows.iter().map(|(_, count)| count).sum();
    let value = rows.iter().map(|(sum, _)| sum).sum::<f64>() / count as f64;
    (!value.is_nan()).then_some(value)
}

/// For the windows whose first row is `y`, from left to right: whether all of their pixels are used.
fn whole_windows(mask: &Mask, y: usize) -> Vec<bool> {
    let side = 2 * RADIUS + 1;
    let used = |x: usize| (y..y + side).all(|row| mask.uses(row * mask.width() + x));
    let columns: Vec<bool> = (0..mask.width()).map(used).collect();
    columns
        .windows(side)
        .map(|columns| columns.iter().all(|used| *used))
        .collect()
}

fn window() -> [f64; 2 * RADIUS + 1] {
    let mut w = [0.0; 2 * RADIUS + 1];
    for (i, v) in w.iter_mut().enumerate() {
        *v = (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp();
    }
    let sum: f64 = w.iter().sum();
    w.map(|v| v / sum)
}

/// Sum of the SSIM map over the windows whose first row is `y` and that are `taken`, and the number of scalars summed. Sums down
/// the columns first, then across.
fn ssim_row(
    a: &[f32],
    b: &[f32],
    width: usize,
    channels: usize,
    y: usize,
    window: &[f64],
    taken: Option<&[bool]>,
) -> (f64, usize) {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let stride = width * channels;
    // Weighted sums of a, b, a^2, b^2, ab.
    let mut columns = vec![[0.0; 5]; stride];
    for (k, &weight) in window.iter().enumerate() {
        let row = (y + k) * stride..(y + k + 1) * stride;
        for ((m, &a), &b) in columns.iter_mut().zip(&a[row.clone()]).zip(&b[row]) {
            let (a, b) = (unit(a), unit(b));
            for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *m += weight * v;
            }
        }
    }
    let windows = stride - (window.len() - 1) * channels;
    let is_taken = |&i: &usize| taken.is_none_or(|taken| taken[i / channels]);
    let mut count = 0;
    let sum = (0..windows)
        .filter(is_taken)
        .map(|i| {
            count += 1;
            let mut m = [0.0; 5];
            for (column, &weight) in columns[i..].iter().step_by(channels).zip(window) {
                for (m, &v) in m.iter_mut().zip(column) {
                    *m += weight * v;
                }
            }
            let [ma, mb, aa, bb, ab] = m;
            let (va, vb, cov) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
            ((2.0 * ma * mb + C1) * (2.0 * cov + C2)) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
        })
        .sum();
    (sum, count)
}
