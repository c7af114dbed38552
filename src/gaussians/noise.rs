//! The noise of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591), which makes Adam's steps on the means those of
//! stochastic gradient Langevin dynamics.

use super::densify::{rotation, standard_normal};
use super::relocate::sigmoid;
use crate::raster::{SplatTensors, Splats};
use burn::tensor::activation::sigmoid as sigmoid_of;
use burn::tensor::{Tensor, TensorData};
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

    /// [`PositionNoise::applied`] in tensors, `[N, 3]`: the host draws the normal numbers alone, for every row.
    pub fn applied_to(&self, splats: &SplatTensors, rng: &ChaCha8Rng) -> Tensor<2> {
        let SplatTensors { means, log_scales, rotations, opacity_logits } = splats.clone();
        let n = splats.len();
        let mut normal = vec![0.0_f32; 3 * n];
        normal.par_chunks_mut(3 * CHUNK).enumerate().for_each(|(chunk, rows)| {
            for (row, i) in rows.as_chunks_mut::<3>().0.iter_mut().zip(chunk * CHUNK..) {
                let mut rng = rng.clone();
                rng.set_word_pos(i as u128 * WORDS);
                *row = [0; 3].map(|_| standard_normal(&mut rng) as f32);
            }
        });
        let normal = Tensor::from_data(TensorData::new(normal, [n, 3]), &means.device());
        let gate = sigmoid_of((sigmoid_of(opacity_logits) - self.opacity) * -self.sharpness).reshape([n, 1]);
        let gate = gate.clone().mask_fill(gate.lower_equal_elem(f32::EPSILON), 0.0);
        // A quaternion of zeros turns nothing, as on the host.
        let square = rotations.clone().powi_scalar(2).sum_dim(1);
        let turns = square.clone().greater_equal_elem(1e-12).float();
        let unit = rotations * (turns / square.clamp_min(1e-12).sqrt());
        let (real, axis) = (unit.clone().slice([0..n, 0..1]), unit.slice([0..n, 1..4]));
        let turned = |v: Tensor<2>, real: Tensor<2>| {
            let across = axis.clone().cross(v.clone(), 1);
            v + (across.clone() * real + axis.clone().cross(across, 1)) * 2.0
        };
        let local = (log_scales * 2.0).exp() * turned(normal, real.clone().neg());
        means + turned(local, real) * gate * self.scale
    }
}
