//! The fused photometric loss: against plain tensors, finite differences, and its own invariants.

use burn::tensor::{Tensor, TensorData};
use coseg::ops::{Photo, photometric_loss, photometric_loss_plain};
use std::sync::Arc;

/// Smooth structure plus noise, in 0..1, never equal for two phases.
fn picture(height: usize, width: usize, phase: f64) -> Vec<f64> {
    (0..height * width * 3)
        .map(|i| {
            let (x, y, c) = ((i / 3 % width) as f64, (i / 3 / width) as f64, (i % 3) as f64);
            let noise = ((i as f64 * 12.9898 + phase * 78.233).sin() * 43758.5453).rem_euclid(1.0);
            0.5 + 0.3 * (0.3 * x + 0.2 * y + c + phase).sin() + 0.15 * (noise - 0.5)
        })
        .collect()
}

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Largest deviation of `gradient` from central differences, over max(|gradient|, rms).
fn worst_deviation(x: &[f64], gradient: &[f64], loss: impl Fn(&[f64]) -> f64) -> f64 {
    let (h, scale) = (1e-5, rms(gradient));
    let mut worst = 0.0_f64;
    for i in (0..x.len()).step_by(5) {
        let mut moved = x.to_vec();
        moved[i] = x[i] + h;
        let above = loss(&moved);
        moved[i] = x[i] - h;
        let numeric = (above - loss(&moved)) / (2.0 * h);
        let deviation = (gradient[i] - numeric).abs() / gradient[i].abs().max(scale);
        assert!(deviation.is_finite(), "scalar {i}");
        worst = worst.max(deviation);
    }
    worst
}

#[test]
fn gradient_matches_central_differences() {
    // taller than one band of rows; narrower than the window; a single pixel
    for (height, width) in [(37, 13), (4, 3), (1, 1)] {
        let (x, y) = (picture(height, width, 0.0), picture(height, width, 0.4));
        let photo = Photo::new(y, height, width);
        for weight in [0.0, 0.2, 1.0] {
            let (_, mut gradient) = photo.compare(&x, weight);
            let loss = |x: &[f64]| photo.compare(x, weight).0;
            let deviation = worst_deviation(&x, &gradient, loss);
            assert!(deviation < 1e-6, "{height}x{width}, weight {weight}: {deviation}");
            gradient.iter_mut().for_each(|g| *g *= 1.01);
            assert!(worst_deviation(&x, &gradient, loss) > 5e-3, "a gradient off by 1 % must be noticed");
        }
    }
}

#[test]
fn fused_loss_and_gradient_equal_plain_tensors() {
    let device = crate::device().autodiff();
    for (height, width) in [(70, 41), (9, 5)] {
        let (x, y) = (narrow(&picture(height, width, 0.0)), narrow(&picture(height, width, 0.4)));
        let tensor = |v: &[f32]| Tensor::<3>::from_data(TensorData::new(v.to_vec(), [height, width, 3]), &device);
        let (a, b) = (tensor(&x).require_grad(), tensor(&x).require_grad());
        let fused = photometric_loss(a.clone(), Arc::new(Photo::new(y.clone(), height, width)), 0.2);
        let plain = photometric_loss_plain(b.clone(), tensor(&y), 0.2);
        // an upstream gradient other than 1
        let ga = a.grad(&(fused.clone() * 3.0).backward()).expect("tracked");
        let gb = b.grad(&(plain.clone() * 3.0).backward()).expect("tracked");
        let (fused, plain) = (fused.into_scalar::<f32>(), plain.into_scalar::<f32>());
        assert!((fused - plain).abs() < 1e-5 * plain, "{fused} against {plain}");
        let read = |t: Tensor<3>| t.into_data().convert::<f64>().into_vec::<f64>().expect("f64");
        let (ga, gb) = (read(ga), read(gb));
        let worst = ga.iter().zip(&gb).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / rms(&gb);
        assert!(ga.iter().all(|g| g.is_finite()) && worst < 1e-4, "{worst}");
    }
}

#[test]
fn equal_images_have_no_loss_and_no_gradient() {
    let x = picture(40, 20, 0.0);
    let (loss, gradient) = Photo::new(x.clone(), 40, 20).compare(&x, 0.2);
    assert!(loss.abs() < 1e-12, "{loss}");
    assert!(gradient.iter().all(|g| g.abs() < 1e-12));
    let (loss, gradient) = Photo::<f64>::new(Vec::new(), 0, 20).compare(&[], 0.2);
    assert!(loss == 0.0 && gradient.is_empty());
}

#[test]
fn same_bits_at_any_thread_count() {
    let (x, y) = (narrow(&picture(90, 33, 0.0)), narrow(&picture(90, 33, 0.4)));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| Photo::new(y.clone(), 90, 33).compare(&x, 0.2))
    };
    assert_eq!(run(1), run(3));
}

/// Not a test of speed, only a print of it: `cargo test --release -- --nocapture photometric_takes`.
#[test]
fn photometric_takes_milliseconds() {
    let (height, width) = (480, 270);
    let (x, y) = (narrow(&picture(height, width, 0.0)), narrow(&picture(height, width, 0.4)));
    let photo = Photo::new(y, height, width);
    let mut times: Vec<f64> = (0..20)
        .map(|_| {
            let start = std::time::Instant::now();
            let (loss, _) = photo.compare(&x, 0.2);
            assert!(loss > 0.0);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    eprintln!("photometric loss and gradient, 270x480: median {:.2} ms, best {:.2} ms", times[10], times[0]);
}
