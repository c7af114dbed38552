//! The noise of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591), which makes Adam's steps on the means those of
//! stochastic gradient Langevin dynamics.

use super::relocate::sigmoid;
#[cfg(feature = "cube")]
use crate::backend::device::in_host_memory;
use crate::backend::device::read;
use crate::error::Result;
#[cfg(feature = "cube")]
use crate::ops::position_noise::{NoiseStep, add_position_noise};
use crate::random::philox::normals;
use crate::random::philox_key;
use crate::raster::{SplatTensors, Splats};
use crate::splat::rotation;
use burn::tensor::{Tensor, TensorData};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Rows that one task handles.
const CHUNK: usize = 1024;

/// `scale sigmoid(-k (o - t)) Sigma eta`, eta standard normal, for a Gaussian of opacity o and covariance Sigma: along its
/// own axes, and only where it is nearly transparent.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionNoise {
    /// One over world units: the noise is a length, Sigma its square.
    pub scale: f64,
    /// k.
    pub sharpness: f64,
    /// t.
    pub opacity: f64,
}

impl PositionNoise {
    /// sigmoid(-k (o - t)).
    pub fn gate(&self, opacity: f64) -> f64 {
        sigmoid(-self.sharpness * (opacity - self.opacity))
    }

    /// The means of `splats` with noise, `[N, 3]`. Each row has numbers of its own under the key of `rng`, so that the result
    /// does not depend on the number of threads; rows whose gate is below the resolution of `f32` stay where they are.
    pub fn applied(&self, splats: &Splats<'_, f32>, rng: &ChaCha8Rng) -> Vec<f32> {
        let key = philox_key(rng);
        let mut means = splats.means.to_vec();
        let (log_scales, rotations) = (
            splats.log_scales.as_chunks::<3>().0,
            splats.rotations.as_chunks::<4>().0,
        );
        means
            .par_chunks_mut(3 * CHUNK)
            .enumerate()
            .for_each(|(chunk, means)| {
                for (mean, i) in means.as_chunks_mut::<3>().0.iter_mut().zip(chunk * CHUNK..) {
                    let gate = self.gate(sigmoid(f64::from(splats.opacity_logits[i])));
                    if gate > f64::from(f32::EPSILON) {
                        let noise = normals(key, i as u32);
                        let variance = log_scales[i].map(|s| (2.0 * f64::from(s)).exp());
                        let turn = rotation(&rotations[i]);
                        // Sigma eta = R diag(variance) R^T eta
                        let local = DVec3::from(variance) * (turn.inverse() * DVec3::from(noise));
                        let moved = (turn * local * (self.scale * gate)).to_array();
                        *mean = [0, 1, 2].map(|k| (f64::from(mean[k]) + moved[k]) as f32);
                    }
                }
            });
        means
    }

    /// [`PositionNoise::applied`] where the tensors lie, `[N, 3]`; on a GPU in one kernel, to rounding the same.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when tensors in host memory cannot be read.
    pub fn applied_to(&self, splats: &SplatTensors, rng: &ChaCha8Rng) -> Result<Tensor<2>> {
        let SplatTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
        } = splats.clone();
        #[cfg(feature = "cube")]
        if !in_host_memory(&means.device()) {
            let step = NoiseStep {
                key: philox_key(rng),
                scale: self.scale as f32,
                sharpness: self.sharpness as f32,
                opacity: self.opacity as f32,
            };
            return Ok(add_position_noise(
                [means, log_scales, rotations],
                opacity_logits,
                step,
            ));
        }
        let (shape, device) = (means.dims(), means.device());
        let splats = Splats {
            means: &read("means", means)?,
            log_scales: &read("log_scales", log_scales)?,
            rotations: &read("rotations", rotations)?,
            opacity_logits: &read("opacity_logits", opacity_logits)?,
        };
        Ok(Tensor::from_data(
            TensorData::new(self.applied(&splats, rng), shape),
            &device,
        ))
    }
}
