//! `W` and `W^T` of a view whose geometry is frozen, and the counter of Algorithm 1.

use super::blend;
use super::pixel_sums;
use super::prepare::{Prepared, check_size, read_words};
use super::project::SPLAT;
use super::sh::Harmonics;
use crate::backend::gpu::{Gpu, launch};
use crate::error::Result;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

/// Pixels whose centres lie within `low..=high`, of `limit`.
#[cube]
fn covered(low: f32, high: f32, limit: f32) -> f32 {
    let first = min(max((low - 0.5f32).ceil(), 0.0f32), limit);
    let end = min((high - 0.5f32).floor() + 1.0f32, limit);
    max(end - first, 0.0f32)
}

/// Pixels within the radius of each Gaussian.
#[cube(launch)]
fn count_pixels(
    splats: &[f32],
    radii: &[u32],
    counts: &mut [u32],
    gaussians: u32,
    width: f32,
    height: f32,
) {
    let i = ABSOLUTE_POS;
    if i >= gaussians as usize {
        terminate!();
    }
    let mut count = 0u32;
    if radii[i] > 0u32 {
        let radius = f32::cast_from(radii[i]);
        let x = splats[SPLAT * i];
        let y = splats[SPLAT * i + 1];
        let mut row = min(max((y - radius - 0.5f32).ceil(), 0.0f32), height);
        let rows = covered(y - radius, y + radius, height);
        let end = row + rows;
        while row < end {
            let dy = row + 0.5f32 - y;
            let half = max(radius * radius - dy * dy, 0.0f32).sqrt();
            count += u32::cast_from(covered(x - half, x + half, width));
            row += 1.0f32;
        }
    }
    counts[i] = count;
}

impl Prepared {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.order.len
    }

    /// Colours `[N, 3]` of the Gaussians with these means, from coefficients `[N, K, 3]` of degree `degree`.
    pub fn colours(&self, means: CubeTensor, sh: CubeTensor, degree: usize) -> CubeTensor {
        Harmonics::new(sh, degree).colours(&means, &self.projected.radii, &self.view)
    }

    /// Disc pixels of every Gaussian.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn disc_pixels(&self) -> Result<Vec<u32>> {
        let gpu = Gpu::of(&self.view);
        let counts = gpu.words(self.len());
        launch!(gpu, count_pixels, gpu.cubes_for(self.len());
            &self.projected.splats, &self.projected.radii, &counts;
            self.len() as u32, self.size[0] as f32, self.size[1] as f32);
        read_words(&gpu, &counts)
    }

    /// The image `[H, W, channels]` of `values` (`[N, channels]`, contiguous), and the transmittance `[H, W]`.
    ///
    /// # Errors
    /// [`crate::Error::Limit`] for what the device cannot hold.
    pub fn blend(&self, values: CubeTensor, channels: usize) -> Result<(CubeTensor, CubeTensor)> {
        let gpu = Gpu::of(&values);
        let count = self.size.iter().product::<usize>();
        let count = count.saturating_mul(channels);
        check_size(&gpu, "pixels times channels", count, size_of::<f32>())?;
        Ok(blend::blend(&gpu, self, &values, channels))
    }

    /// `W^T y` `[N, channels]`; `y` is `[H, W, channels]`, contiguous.
    ///
    /// # Errors
    /// [`crate::Error::Limit`] for what the device cannot hold.
    pub fn lift(&self, y: &CubeTensor, channels: usize) -> Result<CubeTensor> {
        let gpu = Gpu::of(y);
        let count = self.len().saturating_mul(channels);
        check_size(&gpu, "Gaussians times channels", count, size_of::<f32>())?;
        let budget = pixel_sums::row_bytes(&gpu);
        Ok(pixel_sums::adjoint(&gpu, self, y, budget))
    }
}
