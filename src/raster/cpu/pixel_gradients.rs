//! What the backward passes over tiles read of the pixels, and the rows of sums that they write.

use super::moments::MOMENTS;
use crate::backend::Real;

/// Sums of a row besides those of the values, for each Gaussian: moments, and the two of absolute values.
pub(in crate::raster) const fn geometry_sums(absolute: bool) -> usize {
    if absolute { MOMENTS + 2 } else { MOMENTS }
}

/// The output of a forward pass and the gradients of a loss by it.
#[derive(Clone, Copy)]
pub struct PixelGradients<'a, E> {
    /// The rendered image, `[H, W, C]`. It may include a background, `image + T b`: `d_image` then reaches `T` through it.
    pub image: &'a [E],
    /// What shows of the background, `T`, `[H, W]`.
    pub transmittance: &'a [E],
    /// Gradient of the image, `[H, W, C]`.
    pub d_image: &'a [E],
    /// Gradient of the transmittance, `[H, W]`, if any.
    pub d_transmittance: Option<&'a [E]>,
}

impl<E: Real> PixelGradients<'_, E> {
    /// `d_image . image + d_transmittance transmittance` of a pixel: `R` before the first Gaussian.
    #[inline(always)]
    pub(super) fn budget(&self, pixel: usize, channels: usize) -> E {
        let at = pixel * channels;
        let mut sum = self
            .d_transmittance
            .map_or(E::zero(), |d| d[pixel] * self.transmittance[pixel]);
        for c in 0..channels {
            sum += self.d_image[at + c] * self.image[at + c];
        }
        sum
    }
}
