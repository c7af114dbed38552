//! Gaussians with given opacities.

use coseg::reconstruction::initialization;
use coseg::splat::Gaussians;

/// A Gaussian for each of `opacities`, no two at one place.
pub fn population(opacities: &[f32]) -> Gaussians {
    let n = opacities.len();
    Gaussians {
        means: (0..n).map(|i| [i as f32, 0.0, 0.0]).collect(),
        log_scales: (0..n).map(|i| [0.1, 0.2, 0.3 + i as f32]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: opacities
            .iter()
            .map(|&o| initialization::logit(o))
            .collect(),
        sh: (0..3 * n).map(|i| i as f32).collect(),
        sh_degree: 0,
    }
}
