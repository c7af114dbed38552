//! Upsampling from a coarse point set to a fine one by inverse-squared-distance weights (Eq. 7, `US`).

use super::neighbours::PointIndex;
use crate::error::Result;
use crate::ops::SparseMatrix;

/// Points each upsampled feature is mixed from.
pub const SOURCES: usize = 3;

/// The map from features of `coarse` to features of `fine`: row `i` mixes the three nearest coarse points with weights proportional
/// to 1 / d^2 that sum to one. A fine point that lies on a coarse point takes its feature. Fewer than three coarse points: as many
/// as there are.
///
/// # Errors
/// [`crate::Error::NonFinite`] naming the first bad row; [`crate::Error::Argument`] when `coarse` is empty and `fine` not.
pub fn interpolation(coarse: &[[f32; 3]], fine: &[[f32; 3]]) -> Result<SparseMatrix> {
    let k = SOURCES.min(coarse.len()).max(1);
    let (neighbours, distances) = PointIndex::new(coarse)?.nearest(fine, k)?;
    let mut values = Vec::with_capacity(distances.len());
    for row in distances.chunks_exact(k) {
        // d_0 / d_i instead of 1 / d_i: bounded, free of units, and needs no epsilon
        let weights = row
            .iter()
            .map(|&d| if d == row[0] { 1.0 } else { row[0] / d });
        let sum: f64 = weights.clone().sum();
        values.extend(weights.map(|w| (w / sum) as f32));
    }
    let offsets = (0..=fine.len()).map(|i| (i * k) as u32).collect();
    Ok(SparseMatrix::unchecked(
        coarse.len(),
        offsets,
        neighbours.indices,
        values,
    ))
}
