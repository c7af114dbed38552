//! The same scene with another number of Gaussians.

use crate::random::{Purpose, stream};
use crate::splat::{Gaussians, rotation};
use glam::DVec3;
use rand::Rng;

/// `count` Gaussians that cover about what `gaussians` cover, in spatial order.
///
/// Fewer are a random choice. More are copies, moved at random within the extent of the original. Scales change with the
/// square root of the ratio, so that each pixel meets about as many Gaussians as before. Opacities and colours stay. An
/// empty scene stays empty.
#[must_use]
pub fn resampled(gaussians: &Gaussians, count: usize, seed: u64) -> Gaussians {
    let n = gaussians.len();
    if n == 0 {
        return gaussians.clone();
    }
    let mut rng = stream(seed, Purpose::Benchmark, count as u64);
    let mut rows: Vec<u32> = (0..n as u32).cycle().take(count / n * n).collect();
    let rest = rand::seq::index::sample(&mut rng, n, count % n);
    rows.extend(rest.into_iter().map(|i| i as u32));
    let mut out = gaussians.select(&rows);
    for i in n..count {
        let rotation = rotation(&out.rotations[i]);
        // Uniform numbers with variance 1.
        let draw = out.log_scales[i]
            .map(|s| 3.0_f64.sqrt() * rng.random_range(-1.0..1.0) * f64::from(s).exp());
        let mean = DVec3::from(out.means[i].map(f64::from)) + rotation * DVec3::from(draw);
        out.means[i] = mean.as_vec3().to_array();
    }
    let growth = (0.5 * (n as f64 / count as f64).ln()) as f32;
    for scale in out.log_scales.as_flattened_mut() {
        *scale += growth;
    }
    out.select(&out.spatial_order())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_areas_are_kept() {
        let n = 50;
        let from = Gaussians {
            means: (0..n).map(|i| [i as f32, 0.0, 1.0]).collect(),
            log_scales: vec![[-1.0, -1.0, -4.0]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.5; 3 * n],
            sh_degree: 0,
        };
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
        assert!(resampled(&Gaussians::default(), 10, 1).is_empty());
    }
}
