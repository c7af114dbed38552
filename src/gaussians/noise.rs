//! The noise of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591), which makes Adam's steps on the means those of
//! stochastic gradient Langevin dynamics.

use super::densify::{rotation, standard_normal};
use super::relocate::sigmoid;
use crate::raster::Splats;
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Rows that one task handles.
const CHUNK: usize = 1024;
/// 32-bit words of the stream that a row has: three normal numbers of two uniform `f64`.
const WORDS: u128 = 12;

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

    /// The means of `splats` with noise, `[N, 3]`. Each row has numbers of its own in the stream of `rng`, so that the result
    /// does not depend on the number of threads; rows whose gate is below the resolution of `f32` stay where they are.
    pub fn applied(&self, splats: &Splats<'_, f32>, rng: &ChaCha8Rng) -> Vec<f32> {
        let mut means = splats.means.to_vec();
        let (log_scales, rotations) = (splats.log_scales.as_chunks::<3>().0, splats.rotations.as_chunks::<4>().0);
        means.par_chunks_mut(3 * CHUNK).enumerate().for_each(|(chunk, means)| {
            for (mean, i) in means.as_chunks_mut::<3>().0.iter_mut().zip(chunk * CHUNK..) {
                let gate = self.gate(sigmoid(f64::from(splats.opacity_logits[i])));
                if gate > f64::from(f32::EPSILON) {
                    let mut rng = rng.clone();
                    rng.set_word_pos(i as u128 * WORDS);
                    let noise = [0; 3].map(|_| standard_normal(&mut rng));
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
}
