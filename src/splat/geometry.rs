//! The geometry of Gaussians, without their colours.

use super::Gaussians;

/// The geometry of N Gaussians, unactivated: what densification reads.
#[derive(Clone, Copy, Debug)]
pub struct Geometry<'a> {
    /// Centres, `[N, 3]`.
    pub means: &'a [[f32; 3]],
    /// Natural logarithm of the standard deviations, `[N, 3]`.
    pub log_scales: &'a [[f32; 3]],
    /// Quaternions (w, x, y, z), not normalised, `[N, 4]`.
    pub rotations: &'a [[f32; 4]],
    /// Logits of the opacities, `[N]`.
    pub opacity_logits: &'a [f32],
}

impl<'a> Geometry<'a> {
    /// Scalars of a Gaussian.
    const WIDTH: usize = 3 + 3 + 4 + 1;

    /// From all means, then all log-scales, rotations and opacity logits, `[11 N]`.
    pub(crate) fn of_values(values: &'a [f32]) -> Self {
        let n = values.len() / Self::WIDTH;
        let (means, rest) = values.split_at(3 * n);
        let (log_scales, rest) = rest.split_at(3 * n);
        let (rotations, rest) = rest.split_at(4 * n);
        Self {
            means: means.as_chunks().0,
            log_scales: log_scales.as_chunks().0,
            rotations: rotations.as_chunks().0,
            opacity_logits: &rest[..n],
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }
}

impl<'a> From<&'a Gaussians> for Geometry<'a> {
    fn from(gaussians: &'a Gaussians) -> Self {
        Self {
            means: &gaussians.means,
            log_scales: &gaussians.log_scales,
            rotations: &gaussians.rotations,
            opacity_logits: &gaussians.opacity_logits,
        }
    }
}
