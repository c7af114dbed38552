//! The noise of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591), which turns Adam's steps on the means into stochastic
//! gradient Langevin dynamics.

use crate::random::normals;
use crate::raster::SplatTensors;
use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;
use rand_chacha::ChaCha8Rng;

/// Quaternions of a smaller squared length stand for no rotation, as in the rasterizer.
const ZERO_QUATERNION: f64 = 1e-12;

/// `scale sigmoid(-k (o - t)) Sigma eta` for a Gaussian of opacity `o` and covariance `Sigma`, with a standard normal `eta`: noise
/// along the axes of the Gaussian, and only where it is nearly transparent.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionNoise {
    /// One over world units: the noise is a length, `Sigma` the square of one.
    pub scale: f64,
    /// `k`.
    pub sharpness: f64,
    /// `t`.
    pub opacity: f64,
}

impl PositionNoise {
    /// The means of `splats` with noise, `[N, 3]`. The bits depend on the device, but not on the number of threads.
    pub fn apply(&self, splats: &SplatTensors, rng: &mut ChaCha8Rng) -> Tensor<2> {
        let SplatTensors {
            means,
            log_scales,
            rotations,
            opacity_logits,
        } = splats.clone();
        let n = means.dims()[0];
        if n == 0 {
            return means;
        }
        let noise = normals([n, 3], rng, &means.device());
        let opacity = sigmoid(opacity_logits).reshape([n, 1]);
        let gate = sigmoid((opacity - self.opacity) * -self.sharpness);
        let squared = (rotations.clone() * rotations.clone()).sum_dim(1);
        let no_rotation = squared.clone().lower_elem(ZERO_QUATERNION);
        let unit = rotations * squared.sqrt().recip().mask_fill(no_rotation, 0.0);
        let real = unit.clone().slice([0..n, 0..1]);
        let imaginary = unit.slice([0..n, 1..4]);
        // R x = x + 2 (w (v x) + v (v x)) with cross products; the inverse has -w.
        let rotate = |x: Tensor<2>, real: Tensor<2>| {
            let across = imaginary.clone().cross(x.clone(), 1);
            x + (across.clone() * real + imaginary.clone().cross(across, 1)) * 2.0
        };
        // Sigma eta = R diag(variance) R^T eta
        let variance = (log_scales * 2.0).exp();
        let local = rotate(noise, real.clone().neg()) * variance;
        means + rotate(local, real) * gate * self.scale
    }
}
