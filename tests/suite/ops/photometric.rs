//! The fused photometric loss: against plain tensors, finite differences, and its own invariants.

use burn::tensor::{Tensor, TensorData};
use coseg::ops::{PackedPhoto, Photo, photometric_loss, photometric_loss_plain};
use std::sync::Arc;

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

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

/// `picture` in 8 bits, and the values that they stand for.
fn packed(height: usize, width: usize, phase: f64) -> (Arc<PackedPhoto>, Vec<f32>) {
    let bytes: Vec<u8> = picture(height, width, phase)
        .iter()
        .map(|v| (v * 255.0).round() as u8)
        .collect();
    packed_of(bytes, height, width)
}

fn packed_of(bytes: Vec<u8>, height: usize, width: usize) -> (Arc<PackedPhoto>, Vec<f32>) {
    let values = bytes.iter().map(|&v| f32::from(v) / 255.0).collect();
    let pixels =
        image::RgbImage::from_raw(width as u32, height as u32, bytes).expect("as many bytes");
    (Arc::new(PackedPhoto::new(Arc::new(pixels))), values)
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
            assert!(
                deviation < 1e-6,
                "{height}x{width}, weight {weight}: {deviation}"
            );
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
        let (x, y) = (
            narrow(&picture(height, width, 0.0)),
            narrow(&picture(height, width, 0.4)),
        );
        let tensor = |v: &[f32]| {
            Tensor::<3>::from_data(TensorData::new(v.to_vec(), [height, width, 3]), &device)
        };
        let (a, b) = (tensor(&x).require_grad(), tensor(&x).require_grad());
        let fused = photometric_loss(
            a.clone(),
            Arc::new(Photo::new(y.clone(), height, width)),
            0.2,
        );
        let plain = photometric_loss_plain(b.clone(), tensor(&y), 0.2);
        // an upstream gradient other than 1
        let ga = a.grad(&(fused.clone() * 3.0).backward()).expect("tracked");
        let gb = b.grad(&(plain.clone() * 3.0).backward()).expect("tracked");
        let (fused, plain) = (fused.into_scalar::<f32>(), plain.into_scalar::<f32>());
        assert!(
            (fused - plain).abs() < 1e-5 * plain,
            "{fused} against {plain}"
        );
        let read = |t: Tensor<3>| {
            t.into_data()
                .convert::<f64>()
                .into_vec::<f64>()
                .expect("f64")
        };
        let (ga, gb) = (read(ga), read(gb));
        let worst = ga
            .iter()
            .zip(&gb)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max)
            / rms(&gb);
        assert!(ga.iter().all(|g| g.is_finite()) && worst < 1e-4, "{worst}");
    }
}

#[test]
fn bytes_are_compared_on_the_host_as_the_values_that_they_stand_for() {
    for (height, width) in [(37, 13), (1, 1)] {
        let (photo, y) = packed(height, width, 0.4);
        assert_eq!(
            (photo.size(), photo.prepared()),
            ((height, width), Photo::new(y.clone(), height, width))
        );
        let data = TensorData::new(narrow(&picture(height, width, 0.0)), [height, width, 3]);
        let image =
            Tensor::<3>::from_data(data, &crate::support::device().autodiff()).require_grad();
        let bits = |loss: Tensor<1>| {
            let gradient = image.grad(&loss.clone().backward()).expect("tracked");
            (
                loss.into_scalar::<f32>(),
                gradient.into_data().into_vec::<f32>().expect("f32"),
            )
        };
        let want = bits(photometric_loss(
            image.clone(),
            Arc::new(Photo::new(y, height, width)),
            0.2,
        ));
        assert_eq!(bits(photometric_loss(image.clone(), photo, 0.2)), want);
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
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| Photo::new(y.clone(), 90, 33).compare(&x, 0.2))
    };
    assert_eq!(run(1), run(3));
}

/// Not a test of speed, only a print of it: `cargo test --release -- --nocapture photometric_takes`.
#[test]
fn photometric_takes_milliseconds() {
    let (height, width) = (480, 270);
    let (x, y) = (
        narrow(&picture(height, width, 0.0)),
        narrow(&picture(height, width, 0.4)),
    );
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
    eprintln!(
        "photometric loss and gradient, 270x480: median {:.2} ms, best {:.2} ms",
        times[10], times[0]
    );
}

/// The kernels for GPUs against the CPU's in f64, fed the same f32 numbers.
#[cfg(feature = "wgpu")]
mod on_gpu {
    use super::*;
    use crate::support::gpu;
    use burn::tensor::{DType, Device};
    use coseg::backend::host_fallbacks;
    use coseg::data::mask::Mask;
    use coseg::ops::Compared;

    fn widen(values: &[f32]) -> Vec<f64> {
        values.iter().map(|&v| f64::from(v)).collect()
    }

    fn largest(values: impl Iterator<Item = f64>) -> f64 {
        values.fold(0.0, |a, v| a.max(v.abs()))
    }

    /// Loss, and gradient to an image that lies in columns or in rows, of the loss times `factor`.
    fn run(
        device: &Device,
        image: &[f32],
        photo: impl Into<Compared>,
        weight: f64,
        factor: f64,
        in_columns: bool,
    ) -> (f32, Vec<f32>) {
        let photo = photo.into();
        let (height, width) = photo.size();
        let options = (&device.clone().autodiff(), DType::F32);
        let tensor =
            Tensor::<3>::from_data(TensorData::new(image.to_vec(), [height, width, 3]), options);
        // by way of the host, so that the values do lie in columns
        let columns = |t: Tensor<3>| Tensor::<3>::from_data(t.swap_dims(0, 1).into_data(), options);
        let leaf = if in_columns { columns(tensor) } else { tensor }.require_grad();
        let rows = if in_columns {
            leaf.clone().swap_dims(0, 1)
        } else {
            leaf.clone()
        };
        let loss = photometric_loss(rows, photo, weight);
        assert_eq!(loss.dims(), [1]);
        let gradient = leaf
            .grad(&(loss.clone() * factor).backward())
            .expect("tracked");
        let gradient = if in_columns {
            gradient.swap_dims(0, 1)
        } else {
            gradient
        };
        assert_eq!(gradient.dims(), [height, width, 3]);
        (
            loss.into_scalar::<f32>(),
            gradient.into_data().into_vec::<f32>().expect("f32"),
        )
    }

    /// Errors of the loss, relative to it or to the 1 that SSIM is subtracted from, and of the gradient, relative to its
    /// largest value: of the device and of the CPU's f32 kernels.
    fn errors(
        device: &Device,
        images: [&[f32]; 2],
        size: (usize, usize),
        weight: f64,
    ) -> [[f64; 2]; 2] {
        let photo = Arc::new(Photo::new(images[1].to_vec(), size.0, size.1));
        errors_against(device, images, &photo.into(), weight)
    }

    /// [`errors`] where the second image is given to the device as `compared`.
    fn errors_against(
        device: &Device,
        [x, y]: [&[f32]; 2],
        compared: &Compared,
        weight: f64,
    ) -> [[f64; 2]; 2] {
        let size = compared.size();
        let (want_loss, want) = Photo::new(widen(y), size.0, size.1).compare(&widen(x), weight);
        let scale = largest(want.iter().copied());
        let photo = Photo::new(y.to_vec(), size.0, size.1);
        let error = |loss: f64, gradient: &[f32], factor: f64| {
            let off = gradient
                .iter()
                .zip(&want)
                .map(|(&g, w)| f64::from(g) / factor - w);
            assert!(
                loss.is_finite() && gradient.iter().all(|g| g.is_finite()),
                "{size:?}, weight {weight}"
            );
            [
                (loss - want_loss).abs() / want_loss.max(weight),
                largest(off) / scale,
            ]
        };
        let (host_loss, host) = photo.compare(x, weight);
        let mut worst = [0.0_f64; 2];
        for (factor, in_columns) in [(1.0, false), (-2.7, false), (1.0, true)] {
            let (loss, gradient) = run(device, x, compared.clone(), weight, factor, in_columns);
            let found = error(f64::from(loss), &gradient, factor);
            worst = [worst[0].max(found[0]), worst[1].max(found[1])];
        }
        let host = error(host_loss, &host, 1.0);
        eprintln!(
            "{size:?}, weight {weight}: loss off by {:.1e} (CPU in f32 {:.1e}), gradient by {:.1e} ({:.1e})",
            worst[0], host[0], worst[1], host[1]
        );
        [worst, host]
    }

    #[test]
    fn loss_and_gradient_equal_the_cpu_in_f64() {
        let Some(device) = gpu() else { return };
        let mut worst = [0.0_f64; 2];
        // the last one has more sums of tiles than the cube that adds them has units
        for (height, width) in [
            (1, 1),
            (5, 7),
            (40, 3),
            (3, 40),
            (16, 16),
            (17, 33),
            (40, 50),
            (150, 160),
        ] {
            let (x, y) = (
                narrow(&picture(height, width, 0.0)),
                narrow(&picture(height, width, 0.4)),
            );
            for weight in [0.0, 0.2, 1.0] {
                let [[loss, gradient], _] = errors(&device, [&x, &y], (height, width), weight);
                worst = [worst[0].max(loss), worst[1].max(gradient)];
            }
        }
        // 1e-7 is a rounding; the variances divide some of them by a few thousandths.
        assert!(worst[0] < 5e-7, "loss off by {:e}", worst[0]);
        assert!(worst[1] < 1e-5, "gradient off by {:e}", worst[1]);
    }

    #[test]
    fn photos_of_bytes_are_prepared_on_the_device() {
        let Some(device) = gpu() else { return };
        let before = host_fallbacks();
        let mut worst = [0.0_f64; 2];
        for (height, width) in [
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
            let (photo, y) = packed(height, width, 0.4);
            let x = narrow(&picture(height, width, 0.0));
            for weight in [0.0, 0.2, 1.0] {
                let [[loss, gradient], _] =
                    errors_against(&device, [&x, &y], &photo.clone().into(), weight);
                worst = [worst[0].max(loss), worst[1].max(gradient)];
            }
        }
        assert!(worst[0] < 5e-7, "loss off by {:e}", worst[0]);
        assert!(worst[1] < 1e-5, "gradient off by {:e}", worst[1]);
        // The same bytes and the same values: L1 alone, which has no moments, to the bit.
        let (photo, y) = packed(33, 47, 0.4);
        let x = narrow(&picture(33, 47, 0.0));
        let values = Arc::new(Photo::new(y, 33, 47));
        assert_eq!(
            run(&device, &x, photo, 0.0, 1.0, false),
            run(&device, &x, values, 0.0, 1.0, false)
        );
        assert_eq!(host_fallbacks(), before, "tensors went to the host");
    }

    #[test]
    fn what_a_mask_leaves_out_counts_for_nothing_on_a_gpu() {
        let Some(device) = gpu() else { return };
        let before = host_fallbacks();
        for (height, width) in [(1, 1), (5, 7), (17, 33), (151, 161)] {
            let (_, y) = packed(height, width, 0.4);
            let bytes = y.iter().map(|v| (v * 255.0).round() as u8).collect();
            let pixels = image::RgbImage::from_raw(width as u32, height as u32, bytes)
                .expect("as many bytes");
            let x = narrow(&picture(height, width, 0.0));
            let part = Mask::new(width, height, |i| i % width > width / 3 || i % 13 == 0);
            for mask in [part, Mask::new(width, height, |_| true)] {
                let host = Photo::masked(widen(&y), height, width, mask.clone());
                let photos: [Compared; 2] = [
                    Arc::new(Photo::masked(y.clone(), height, width, mask.clone())).into(),
                    Arc::new(PackedPhoto::masked(&pixels, mask.clone())).into(),
                ];
                for (photo, weight) in photos
                    .iter()
                    .flat_map(|photo| [0.0, 0.2, 1.0].map(|weight| (photo, weight)))
                {
                    let (want_loss, want) = host.compare(&widen(&x), weight);
                    let (loss, gradient) = run(&device, &x, photo.clone(), weight, 1.0, false);
                    assert!(
                        (f64::from(loss) - want_loss).abs() < 5e-7 * want_loss.max(weight),
                        "{loss} {want_loss}"
                    );
                    let off = gradient.iter().zip(&want).map(|(&g, w)| f64::from(g) - w);
                    assert!(largest(off) < 1e-5 * largest(want.iter().copied()).max(1e-9));
                    let hidden = gradient
                        .chunks(3)
                        .enumerate()
                        .filter(|(i, _)| !mask.uses(*i));
                    assert!(
                        hidden.into_iter().all(|(_, pixel)| pixel == [0.0; 3]),
                        "exactly zero"
                    );
                    if mask.left_out() == 0 {
                        let bare = Arc::new(Photo::new(y.clone(), height, width));
                        let packed = Arc::new(PackedPhoto::new(Arc::new(pixels.clone())));
                        let whole: Compared = if matches!(photo, Compared::Packed(_)) {
                            packed.into()
                        } else {
                            bare.into()
                        };
                        assert_eq!(
                            run(&device, &x, whole, weight, 1.0, false),
                            (loss, gradient)
                        );
                    }
                }
            }
        }
        assert_eq!(host_fallbacks(), before, "tensors went to the host");
    }

    #[test]
    fn flat_photos_of_bytes_are_about_as_near_as_on_the_cpu() {
        let Some(device) = gpu() else { return };
        let (height, width) = (37, 45);
        let noisy = narrow(&picture(height, width, 0.0));
        for (x, byte) in [
            (vec![0.9; noisy.len()], 204),
            (noisy.clone(), 0),
            (noisy.clone(), 255),
            (noisy, 100),
        ] {
            let (photo, y) = packed_of(vec![byte; height * width * 3], height, width);
            let [[loss, gradient], [host_loss, host_gradient]] =
                errors_against(&device, [&x, &y], &photo.into(), 0.2);
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
    fn flat_and_saturated_images_are_about_as_near_as_on_the_cpu() {
        let Some(device) = gpu() else { return };
        let (height, width) = (37, 45);
        let noisy = narrow(&picture(height, width, 0.0));
        let flat = |value: f32| vec![value; height * width * 3];
        // Variances are differences of squares there, and the digits that are left depend on the order of the sums.
        for (x, y) in [
            (flat(0.9), flat(0.8)),
            (flat(1.0), noisy.clone()),
            (noisy, flat(0.0)),
            (flat(0.0), flat(1.0)),
        ] {
            let [[loss, gradient], [host_loss, host_gradient]] =
                errors(&device, [&x, &y], (height, width), 0.2);
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
        let x = narrow(&picture(40, 50, 0.0));
        let photo = Arc::new(Photo::new(x.clone(), 40, 50));
        let (loss, gradient) = run(&device, &x, photo, 0.2, 1.0, false);
        // against 1 / (values) of an image that differs
        let worst = largest(gradient.iter().map(|&g| f64::from(g))) * x.len() as f64;
        eprintln!("equal images: loss {loss:e}, gradient {worst:e} of that of another image");
        assert!(
            loss.abs() < 1e-6 && worst < 1e-4,
            "loss {loss:e}, gradient {worst:e}"
        );
    }

    #[test]
    fn a_gpu_gives_the_same_bits_every_time() {
        let Some(device) = gpu() else { return };
        let (x, y) = (
            narrow(&picture(90, 133, 0.0)),
            narrow(&picture(90, 133, 0.4)),
        );
        // the photo is uploaded by each
        let once = || {
            run(
                &device,
                &x,
                Arc::new(Photo::new(y.clone(), 90, 133)),
                0.2,
                1.3,
                false,
            )
        };
        assert_eq!(once(), once());
    }

    #[test]
    fn an_image_without_pixels_is_left_to_the_cpu() {
        let Some(device) = gpu() else { return };
        let image = Tensor::<3>::zeros([0, 20, 3], (&device, DType::F32));
        let loss = photometric_loss(image, Arc::new(Photo::new(Vec::new(), 0, 20)), 0.2);
        assert_eq!(loss.into_scalar::<f32>(), 0.0);
    }
}
