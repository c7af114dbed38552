//! Curves within checkpoints, bit for bit.

use super::checkpoint::Checkpoint;
use super::progress::CurvePoint;
use crate::error::Result;
use crate::metrics::ImageScores;

/// Numbers of a point.
const COLUMNS: usize = 7;

/// Adds the tensor `curve`.
///
/// # Errors
/// None: the shape is that of the values.
pub(crate) fn put(checkpoint: &mut Checkpoint, curve: &[CurvePoint]) -> Result<()> {
    let row = |p: &CurvePoint| -> [f64; COLUMNS] {
        let score = |s: Option<f64>| s.unwrap_or(f64::NAN);
        let [psnr, ssim, miou] = [p.held_out.psnr, p.held_out.ssim, p.miou].map(score);
        [
            p.iteration as f64,
            p.seconds,
            p.loss,
            psnr,
            ssim,
            miou,
            p.gaussians as f64,
        ]
    };
    checkpoint.put(
        "curve",
        &[curve.len(), COLUMNS],
        curve.iter().flat_map(row).collect::<Vec<f64>>(),
    )
}

/// Takes the tensor `curve`.
///
/// # Errors
/// [`crate::Error::Input`] naming it when it is missing or of another shape.
pub(crate) fn take(checkpoint: &mut Checkpoint) -> Result<Vec<CurvePoint>> {
    let points = checkpoint.shape("curve")?.first().copied().unwrap_or(0);
    let values: Vec<f64> = checkpoint.take("curve", &[points, COLUMNS])?;
    let score = |v: f64| (!v.is_nan()).then_some(v);
    let point =
        |&[iteration, seconds, loss, psnr, ssim, miou, gaussians]: &[f64; COLUMNS]| CurvePoint {
            iteration: iteration as usize,
            seconds,
            loss,
            held_out: ImageScores {
                psnr: score(psnr),
                ssim: score(ssim),
            },
            miou: score(miou),
            gaussians: gaussians as usize,
        };
    Ok(values.as_chunks().0.iter().map(point).collect())
}
