//! Gaussians with values of every size, and what rounding did to them.

use coseg::splat::{Gaussians, SH_0};
use glam::DQuat;

/// `n` Gaussians as trained ones are, every value different.
pub fn gaussians(n: usize, sh_degree: usize) -> Gaussians {
    let wave = |i: usize, k: usize| (0.37 * i as f32 + 1.9 * k as f32).sin();
    let width = 3 * (sh_degree + 1).pow(2);
    let sh = |i: usize| if i % width < 3 { 1.5 } else { 0.4 } * wave(i, 11);
    Gaussians {
        means: (0..n)
            .map(|i| [10.0 * wave(i, 0), 7.0 * wave(i, 1), 3.0 * wave(i, 2)])
            .collect(),
        log_scales: (0..n)
            .map(|i| [3, 4, 5].map(|k| 2.0 * wave(i, k) - 4.0))
            .collect(),
        rotations: (0..n)
            .map(|i| [6, 7, 8, 9].map(|k| 2.0 * wave(i, k)))
            .collect(),
        opacity_logits: (0..n).map(|i| 5.0 * wave(i, 10)).collect(),
        sh: (0..n * width).map(sh).collect(),
        sh_degree,
    }
}

/// The largest distance of two lists of values.
pub fn worst(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

/// Largest errors of positions, log-scales, opacities, colours, higher coefficients, and rotations in degrees.
pub fn errors(a: &Gaussians, b: &Gaussians) -> [f32; 6] {
    assert_eq!((a.len(), a.sh_degree), (b.len(), b.sh_degree));
    let opacities = |g: &Gaussians| -> Vec<f32> {
        let opacity = |v: &f32| 1.0 / (1.0 + (-v).exp());
        g.opacity_logits.iter().map(opacity).collect()
    };
    let parts = |g: &Gaussians| -> (Vec<f32>, Vec<f32>) {
        let rows = g.sh.chunks_exact(3 * g.sh_len());
        let (colors, higher): (Vec<_>, Vec<_>) = rows.map(|row| row.split_at(3)).unzip();
        (colors.concat(), higher.concat())
    };
    let angle = |(a, b): (&[f32; 4], &[f32; 4])| {
        let [a, b] = [a, b].map(|q| DQuat::from_array(q.map(f64::from)).normalize());
        2.0 * a.dot(b).abs().min(1.0).acos().to_degrees() as f32
    };
    let (colors, higher) = (parts(a), parts(b));
    [
        worst(a.means.as_flattened(), b.means.as_flattened()),
        worst(a.log_scales.as_flattened(), b.log_scales.as_flattened()),
        worst(&opacities(a), &opacities(b)),
        SH_0 * worst(&colors.0, &higher.0),
        worst(&colors.1, &higher.1),
        a.rotations
            .iter()
            .zip(&b.rotations)
            .map(angle)
            .fold(0.0, f32::max),
    ]
}
