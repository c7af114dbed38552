//! The same scene with another number of Gaussians.

use crate::random::{Purpose, stream};
use crate::splat::Gaussians;
use glam::{DQuat, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// `count` Gaussians that cover about what `gaussians` cover.
///
/// Fewer: a random choice; more: all of them several times, copies moved by a draw from the Gaussian itself. Scales grow
/// or shrink with the square root of the ratio, as surfaces ask for, so that each pixel meets about as many as before.
/// Opacities and colours stay. They come in spatial order, as training stores them. Nothing is made of nothing: an empty
/// scene stays empty.
#[must_use]
pub fn resampled(gaussians: &Gaussians, count: usize, seed: u64) -> Gaussians {
    let n = gaussians.len();
    if n == 0 || n == count {
        return gaussians.clone();
    }
    let mut rng = stream(seed, Purpose::Benchmark, count as u64);
    let whole = count / n;
    let mut rows: Vec<u32> = (0..whole).flat_map(|_| 0..n as u32).collect();
    rows.extend(
        rand::seq::index::sample(&mut rng, n, count - whole * n)
            .into_iter()
            .map(|i| i as u32),
    );
    let mut out = gaussians.select(&rows);
    let ratio = n as f64 / count as f64;
    for (i, scales) in out.log_scales.iter_mut().enumerate() {
        if i >= n {
            let [w, x, y, z] = out.rotations[i].map(f64::from);
            let turn = DQuat::from_xyzw(x, y, z, w);
            let turn = if turn.length_squared() > 1e-12 {
                turn.normalize()
            } else {
                DQuat::IDENTITY
            };
            let draw = DVec3::from(scales.map(|s| normal(&mut rng) * f64::from(s).exp()));
            let moved = DVec3::from(out.means[i].map(f64::from)) + turn * draw;
            out.means[i] = moved.as_vec3().to_array();
        }
        for s in scales {
            *s += (0.5 * ratio.ln()) as f32;
        }
    }
    out.select(&out.spatial_order())
}

/// A standard normal number (Box-Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(n: usize) -> Gaussians {
        Gaussians {
            means: (0..n).map(|i| [i as f32, 0.0, 1.0]).collect(),
            log_scales: vec![[-1.0, -1.0, -4.0]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.5; 3 * n],
            sh_degree: 0,
        }
    }

    #[test]
    fn counts_and_areas_are_kept() {
        let from = scene(50);
        for count in [1, 20, 50, 51, 170] {
            let out = resampled(&from, count, 1);
            assert_eq!((out.len(), out.sh.len()), (count, 3 * count));
            let area = |g: &Gaussians| {
                g.log_scales
                    .iter()
                    .map(|s| f64::from(s[0] + s[1]).exp())
                    .sum::<f64>()
            };
            assert!((area(&out) / area(&from) - 1.0).abs() < 1e-4, "{count}");
            assert!(out.means.as_flattened().iter().all(|v| v.is_finite()));
        }
        assert_eq!(resampled(&from, 50, 1), from);
        assert!(resampled(&Gaussians::default(), 10, 1).is_empty());
    }
}
