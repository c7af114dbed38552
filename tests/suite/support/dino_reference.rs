//! A ViT written as plainly as it goes.

use crate::support::dino_weights::{Size, Tensors};

/// The network in f64 by plain loops, for images of whole patches on the grid of the position embeddings.
pub fn by_plain_loops(weights: &Tensors, size: Size, planes: &[f32]) -> Vec<f64> {
    let Size {
        width: d,
        patch: p,
        depth,
        side,
        ..
    } = size;
    let get = |name: &str| -> Vec<f64> { weights[name].1.iter().map(|&v| f64::from(v)).collect() };
    let linear = |name: &str, rows: &[f64]| -> Vec<f64> {
        let (w, b) = (get(&format!("{name}.weight")), get(&format!("{name}.bias")));
        let row = |x: &[f64]| -> Vec<f64> {
            w.chunks(x.len())
                .zip(&b)
                .map(|(w, b)| b + w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>())
                .collect()
        };
        rows.chunks(w.len() / b.len()).flat_map(row).collect()
    };
    let norm = |name: &str, rows: &[f64]| -> Vec<f64> {
        let (w, b) = (get(&format!("{name}.weight")), get(&format!("{name}.bias")));
        let row = |x: &[f64]| -> Vec<f64> {
            let mean = x.iter().sum::<f64>() / d as f64;
            let deviation =
                (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / d as f64 + 1e-6).sqrt();
            (0..d)
                .map(|c| (x[c] - mean) / deviation * w[c] + b[c])
                .collect()
        };
        rows.chunks(d).flat_map(row).collect()
    };
    let erf = |x: f64| {
        let (mut term, mut sum) = (x, x);
        for n in 1..200 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        if x.abs() > 4.5 {
            x.signum()
        } else {
            sum * std::f64::consts::FRAC_2_SQRT_PI
        }
    };
    let add = |a: &mut Vec<f64>, b: Vec<f64>| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);

    let mut x = get("cls_token");
    let pixels = p * side;
    for (top, left) in (0..side).flat_map(|y| (0..side).map(move |x| (y * p, x * p))) {
        let plane = |c: usize| {
            (0..p * p).map(move |i| planes[(c * pixels + top + i / p) * pixels + left + i % p])
        };
        let patch: Vec<f64> = (0..3).flat_map(plane).map(f64::from).collect();
        x.extend(linear("patch_embed.proj", &patch));
    }
    add(&mut x, get("pos_embed"));
    let n = x.len() / d;
    for block in (0..depth).map(|n| format!("blocks.{n}")) {
        let qkv = linear(
            &format!("{block}.attn.qkv"),
            &norm(&format!("{block}.norm1"), &x),
        );
        let mut attended = vec![0.0; n * d];
        for (i, head) in (0..n).flat_map(|i| (0..d).step_by(64).map(move |h| (i, h))) {
            let part = |token: usize, which: usize| &qkv[(3 * token + which) * d + head..][..64];
            let score = |j| {
                part(i, 0)
                    .iter()
                    .zip(part(j, 1))
                    .map(|(a, b)| a * b)
                    .sum::<f64>()
                    / 8.0
            };
            let powers: Vec<f64> = (0..n).map(|j| f64::exp(score(j))).collect();
            let sum: f64 = powers.iter().sum();
            for (j, power) in powers.iter().enumerate() {
                let values = attended[i * d + head..][..64].iter_mut().zip(part(j, 2));
                values.for_each(|(o, v)| *o += power / sum * v);
            }
        }
        add(&mut x, linear(&format!("{block}.attn.proj"), &attended));
        let mut hidden = linear(
            &format!("{block}.mlp.fc1"),
            &norm(&format!("{block}.norm2"), &x),
        );
        hidden
            .iter_mut()
            .for_each(|v| *v *= 0.5 * (1.0 + erf(*v / 2.0_f64.sqrt())));
        add(&mut x, linear(&format!("{block}.mlp.fc2"), &hidden));
    }
    norm("norm", &x)
}
