//! The fused photometric loss: against plain tensors, finite differences, and its own invariants.

use crate::support::photometric::{Loss, compare, run, target, target_of};
use burn::tensor::DType;
use coseg::data::mask::Mask;
use coseg::ops::{photometric_loss, photometric_loss_plain};

/// Smooth structure plus noise, in 0..1, never equal for two phases.
fn picture(height: usize, width: usize, phase: f64) -> Vec<f64> {
    (0..height * width * 3)
        .map(|i| {
            let (x, y, c) = (
                (i / 3 % width) as f64,
                (i / 3 / width) as f64,
                (i % 3) as f64,
            );
            let noise = ((i as f64 * 12.9898 + phase * 78.233).sin() * 43758.5453).rem_euclid(1.0);
            0.5 + 0.3 * (0.3 * x + 0.2 * y + c + phase).sin() + 0.15 * (noise - 0.5)
        })
        .collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Largest deviation of `gradient` from central differences, over max(|gradient|, rms).
fn worst_deviation(x: &[f64], gradient: &[f64], loss: impl Fn(&[f64]) -> f64) -> f64 {
    let h = 1e-5;
    let scale = rms(gradient);
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
    for size in [(37, 13), (4, 3), (1, 1)] {
        let x = picture(size.0, size.1, 0.0);
        let target = target(&picture(size.0, size.1, 0.4), size, None);
        for weight in [0.0, 0.2, 1.0] {
            let (_, mut gradient) = compare(&target, &x, weight);
            let loss = |x: &[f64]| compare(&target, x, weight).0;
            let deviation = worst_deviation(&x, &gradient, loss);
            assert!(deviation < 1e-6, "{size:?}, weight {weight}: {deviation}");
            gradient.iter_mut().for_each(|g| *g *= 1.01);
            assert!(
                worst_deviation(&x, &gradient, loss) > 5e-3,
                "a gradient off by 1 % must be noticed"
            );
        }
    }
}

#[test]
fn fused_loss_and_gradient_equal_plain_tensors() {
    let device = crate::support::device().autodiff();
    for (height, width) in [(70, 41), (9, 5)] {
        let size = (height, width);
        let x = picture(height, width, 0.0);
        let some = Mask::new(width, height, |i| i % width > width / 3 || i % 13 == 0);
        for mask in [None, Some(some)] {
            let target = target(&picture(height, width, 0.4), size, mask);
            // an upstream gradient other than 1
            let of = |loss: Loss<'_>| run(loss, &x, size, 3.0, (&device, DType::F32));
            let (fused, got) = of(&|image| photometric_loss(image, &target, 0.2));
            let (plain, want) = of(&|image| photometric_loss_plain(image, &target, 0.2));
            assert!(
                (fused - plain).abs() < 1e-5 * plain,
                "{fused} against {plain}"
            );
            let off = got.iter().zip(&want).map(|(a, b)| (a - b).abs());
            let worst = off.fold(0.0, f64::max) / rms(&want);
            assert!(got.iter().all(|g| g.is_finite()) && worst < 1e-4, "{worst}");
        }
    }
}

#[test]
fn equal_images_have_no_loss_and_no_gradient() {
    let bytes: Vec<u8> = (0..40 * 20 * 3).map(|i| (i * 37 % 251) as u8).collect();
    let x: Vec<f64> = bytes
        .iter()
        .map(|&v| f64::from(f32::from(v) / 255.0))
        .collect();
    let (loss, gradient) = compare(&target_of(bytes, (40, 20), None), &x, 0.2);
    assert!(loss.abs() < 1e-12, "{loss}");
    assert!(gradient.iter().all(|g| g.abs() < 1e-12));
    let (loss, gradient) = compare(&target_of(Vec::new(), (0, 20), None), &[], 0.2);
    assert!(loss == 0.0 && gradient.is_empty());
}

#[test]
fn same_bits_at_any_thread_count() {
    let x = picture(90, 33, 0.0);
    let compare = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        let target = target(&picture(90, 33, 0.4), (90, 33), None);
        let device = crate::support::device().autodiff();
        let loss = |image| photometric_loss(image, &target, 0.2);
        pool.install(|| run(&loss, &x, (90, 33), 1.0, (&device, DType::F32)))
    };
    assert_eq!(compare(1), compare(3));
}

/// The kernels for GPUs against the CPU's in f64, fed the same f32 numbers.
#[cfg(feature = "wgpu")]
mod on_gpu {
    use super::*;
    use crate::support::gpu;
    use burn::tensor::{Device, Tensor};
    use coseg::backend::host_fallbacks;
    use coseg::ops::PhotometricTarget;
    use std::sync::Arc;

    /// `picture` in numbers that an f32 holds.
    fn single(height: usize, width: usize) -> Vec<f64> {
        let values = picture(height, width, 0.0);
        values.iter().map(|&v| f64::from(v as f32)).collect()
    }

    fn largest(values: impl Iterator<Item = f64>) -> f64 {
        values.fold(0.0, |a, v| a.max(v.abs()))
    }

    /// Errors of the loss, relative to it or to the 1 that SSIM is subtracted from, and of the gradient, relative to its
    /// largest value: of the GPU and of the CPU's f32 kernels.
    fn errors(
        gpu: &Device,
        target: &Arc<PhotometricTarget>,
        x: &[f64],
        weight: f64,
    ) -> [[f64; 2]; 2] {
        let size = target.size();
        let (want_loss, want) = compare(target, x, weight);
        let scale = largest(want.iter().copied()).max(1e-9);
        let loss = |image| photometric_loss(image, target, weight);
        // An image that lies in columns.
        let in_columns = |image: Tensor<3>| {
            let columns = image.swap_dims(0, 1) * 1.0;
            photometric_loss(columns.swap_dims(0, 1), target, weight)
        };
        let error = |loss: Loss<'_>, factor: f64, device: &Device| {
            let (loss, gradient) = run(loss, x, size, factor, (device, DType::F32));
            let off = gradient.iter().zip(&want).map(|(g, w)| g / factor - w);
            assert!(loss.is_finite() && gradient.iter().all(|g| g.is_finite()));
            [
                (loss - want_loss).abs() / want_loss.max(weight),
                largest(off) / scale,
            ]
        };
        let gpu = gpu.clone().autodiff();
        let worst = [
            error(&loss, 1.0, &gpu),
            error(&loss, -2.7, &gpu),
            error(&in_columns, 1.0, &gpu),
        ]
        .into_iter()
        .fold([0.0_f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
        let host = error(&loss, 1.0, &crate::support::device().autodiff());
        eprintln!(
            "{size:?}, weight {weight}: loss off by {:.1e} (CPU in f32 {:.1e}), gradient by {:.1e} ({:.1e})",
            worst[0], host[0], worst[1], host[1]
        );
        [worst, host]
    }

    #[test]
    fn loss_and_gradient_equal_the_cpu_in_f64() {
        let Some(device) = gpu() else { return };
        let before = host_fallbacks();
        // the last one has more sums of tiles than the cube that adds them has units
        for size in [
            (1, 1),
            (1, 2),
            (5, 7),
            (40, 3),
            (3, 40),
            (16, 16),
            (17, 33),
            (40, 50),
            (151, 161),
        ] {
            let (height, width) = size;
            let part = Mask::new(width, height, |i| i % width > width / 3 || i % 13 == 0);
            for mask in [None, Some(part), Some(Mask::new(width, height, |_| true))] {
                let target = target(&picture(height, width, 0.4), size, mask.clone());
                let x = single(height, width);
                for weight in [0.0, 0.2, 1.0] {
                    let [[loss, gradient], _] = errors(&device, &target, &x, weight);
                    // 1e-7 is a rounding; the variances divide some of them by a few thousandths.
                    assert!(loss < 5e-7, "loss off by {loss:e}");
                    assert!(gradient < 1e-5, "gradient off by {gradient:e}");
                    let Some(mask) = &mask else { continue };
                    let loss = |image| photometric_loss(image, &target, weight);
                    let gpu = device.clone().autodiff();
                    let (_, gradient) = run(&loss, &x, size, 1.0, (&gpu, DType::F32));
                    let hidden = gradient
                        .chunks(3)
                        .enumerate()
                        .filter(|(i, _)| !mask.uses(*i));
                    assert!(
                        hidden.into_iter().all(|(_, pixel)| pixel == [0.0; 3]),
                        "exactly zero"
                    );
                }
            }
        }
        assert_eq!(host_fallbacks(), before, "tensors went to the host");
    }

    #[test]
    fn flat_and_saturated_images_are_about_as_near_as_on_the_cpu() {
        let Some(device) = gpu() else { return };
        let size = (37, 45);
        let noisy = single(size.0, size.1);
        let flat = |value: f32| vec![f64::from(value); noisy.len()];
        let bytes = |byte: u8| target_of(vec![byte; 37 * 45 * 3], size, None);
        // Variances are differences of squares there, and the digits that are left depend on the order of the sums.
        for (x, target) in [
            (flat(0.9), bytes(204)),
            (noisy.clone(), bytes(0)),
            (noisy.clone(), bytes(255)),
            (noisy.clone(), bytes(100)),
            (
                flat(1.0),
                super::target(&picture(size.0, size.1, 0.0), size, None),
            ),
            (flat(0.0), bytes(255)),
        ] {
            let [[loss, gradient], [host_loss, host_gradient]] = errors(&device, &target, &x, 0.2);
            assert!(
                loss < 4.0 * host_loss + 1e-6,
                "loss off by {loss:e} against {host_loss:e}"
            );
            assert!(
                gradient < 4.0 * host_gradient + 1e-6,
                "gradient off by {gradient:e} against {host_gradient:e}"
            );
        }
    }

    #[test]
    fn equal_images_have_next_to_no_loss_on_a_gpu() {
        let Some(device) = gpu() else { return };
        let bytes: Vec<u8> = (0..40 * 50 * 3).map(|i| (i * 37 % 251) as u8).collect();
        let x: Vec<f64> = bytes
            .iter()
            .map(|&v| f64::from(f32::from(v) / 255.0))
            .collect();
        let target = target_of(bytes, (40, 50), None);
        // SSIM alone: the derivative of L1 at equality is the sign of a rounding.
        let loss = |image| photometric_loss(image, &target, 1.0);
        let device = device.autodiff();
        let (loss, gradient) = run(&loss, &x, (40, 50), 1.0, (&device, DType::F32));
        // against 1 / (values) of an image that differs
        let worst = largest(gradient.iter().copied()) * x.len() as f64;
        eprintln!("equal images: loss {loss:e}, gradient {worst:e} of that of another image");
        assert!(
            loss.abs() < 1e-6 && worst < 1e-4,
            "loss {loss:e}, gradient {worst:e}"
        );
    }

    #[test]
    fn a_gpu_gives_the_same_bits_every_time() {
        let Some(device) = gpu() else { return };
        let device = device.autodiff();
        let x = single(90, 133);
        // each uploads the photo
        let once = || {
            let target = target(&picture(90, 133, 0.4), (90, 133), None);
            let loss = |image| photometric_loss(image, &target, 0.2);
            run(&loss, &x, (90, 133), 1.3, (&device, DType::F32))
        };
        assert_eq!(once(), once());
    }

    #[test]
    fn an_image_without_pixels_is_left_to_the_cpu() {
        let Some(device) = gpu() else { return };
        let image = Tensor::<3>::zeros([0, 20, 3], (&device, DType::F32));
        let loss = photometric_loss(image, &target_of(Vec::new(), (0, 20), None), 0.2);
        assert_eq!(loss.into_scalar::<f32>(), 0.0);
    }
}
