//! Blending with frozen geometry is a linear map `W`: it, its adjoint, and its disc pixels.

use super::disc_pixels::count;
use super::footprint::Splat2;
use super::projected::{Blended, CHUNK, Projected};
use super::{blend, channel_blocks};
use crate::backend::Real;
use crate::data::mask::Mask;
use rayon::prelude::*;

impl<E: Real> Projected<E> {
    /// `S = W s` (Eq. 3-4) and the transmittance: `values` is `[N, channels]`, the image `[H, W, channels]`.
    ///
    /// # Panics
    /// If `values` does not have `N * channels` entries.
    pub fn blend(&self, values: &[E], channels: usize) -> Blended<E> {
        assert_eq!(
            values.len(),
            self.len() * channels,
            "blend: values against Gaussians times channels"
        );
        match channels {
            0 => blend::blend::<E, 0>(self, values, channels),
            1 => blend::blend::<E, 1>(self, values, channels),
            2 | 3 => blend::blend::<E, 3>(self, values, channels),
            4..=8 => blend::blend::<E, 8>(self, values, channels),
            9..=16 => blend::blend::<E, 16>(self, values, channels),
            17..=24 => blend::blend::<E, 24>(self, values, channels),
            _ => channel_blocks::blend(self, values, channels),
        }
    }

    /// `W^T y`: `image` is `[H, W, channels]`, the result `[N, channels]`; the adjoint of [`Projected::blend`].
    ///
    /// # Panics
    /// If `image` does not have `H * W * channels` entries.
    pub fn blend_adjoint(&self, image: &[E], channels: usize) -> Vec<E> {
        let [w, h] = self.size();
        assert_eq!(
            image.len(),
            w * h * channels,
            "blend_adjoint: image against pixels times channels"
        );
        let sums = match channels {
            0 => return Vec::new(),
            1 => blend::adjoint::<E, 1>(self, image),
            3 => blend::adjoint::<E, 3>(self, image),
            _ => channel_blocks::adjoint(self, image, channels),
        };
        self.in_scene_order(&sums, channels)
    }

    /// `W^T 1`: the sum of alpha' T over all pixels, `[N]`.
    pub fn weight_sums(&self) -> Vec<E> {
        let [w, h] = self.size();
        self.blend_adjoint(&vec![E::one(); w * h], 1)
    }

    /// Algorithm 1's counter: pixels whose centre lies within [`Projected::radii`] of the projected centre, in the image.
    pub fn counts(&self) -> Vec<u32> {
        self.used_counts(None)
    }

    /// [`Projected::counts`] of the pixels that `mask`, of the camera's size, uses.
    pub fn used_counts(&self, mask: Option<&Mask>) -> Vec<u32> {
        let before = mask.map(|mask| used_before(mask, self.size()));
        let count = |(splat, &id): (&Splat2, &u32)| {
            let radius = self.radii()[id as usize];
            count(splat.center, radius, self.size(), before.as_deref())
        };
        let visible = self.splats.par_iter().zip(&self.ids);
        let visible: Vec<u32> = visible.with_min_len(CHUNK).map(count).collect();
        let mut counts = vec![0; self.len()];
        for (count, &id) in visible.into_iter().zip(&self.ids) {
            counts[id as usize] = count;
        }
        counts
    }
}

/// For each row how many pixels are used before each pixel, and then their total, `[height, width + 1]`.
fn used_before(mask: &Mask, [width, height]: [usize; 2]) -> Vec<u32> {
    let mut before = Vec::with_capacity(height * (width + 1));
    for row in 0..height {
        let mut sum = 0;
        before.push(sum);
        before.extend((row * width..(row + 1) * width).map(|pixel| {
            sum += u32::from(mask.uses(pixel));
            sum
        }));
    }
    before
}
