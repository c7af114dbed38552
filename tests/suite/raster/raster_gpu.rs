//! The rasterizer's GPU kernels: repeatability and errors.

use crate::support::gpu;
use crate::support::raster_precision::{Channels, RGB, input, plain, run, values};
use crate::support::raster_reference::{Cloud, camera, cloud, numbers};
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::Error;
use coseg::raster::{RasterInput, Settings, rasterize};

#[test]
fn sums_of_absolute_values_change_no_other_gradient() {
    let Some(device) = gpu() else { return };
    let device = device.autodiff();
    let camera = camera(40, 31);
    let scene = cloud(60, 0.04, &camera, 12);
    for channels in [RGB, plain(1), plain(8), plain(9)] {
        let of = |columns: usize| {
            let screen =
                Tensor::<2>::zeros([scene.len(), columns], (&device, DType::F32)).require_grad();
            let input = RasterInput {
                screen: Some(screen),
                ..input(&scene, channels, &device, DType::F32)
            };
            let image = rasterize(input.clone(), &camera, &Settings::default(), [0.0; 3])
                .expect("valid")
                .image;
            let shape = image.dims();
            let weights =
                TensorData::new(numbers(shape.iter().product(), 77), shape).convert::<f32>();
            let grads = (image * Tensor::<3>::from_data(weights, &device))
                .sum()
                .backward();
            let screen = values(input.screen.expect("given").grad(&grads).expect("tracked"));
            (values(input.means.grad(&grads).expect("tracked")), screen)
        };
        let ((means, two), (same, four)) = (of(2), of(4));
        let sums: Vec<f64> = four
            .chunks_exact(4)
            .flat_map(|row| [row[0], row[1]])
            .collect();
        let bounded =
            |row: &[f64]| row[2] >= row[0].abs() * 0.9999 && row[3] >= row[1].abs() * 0.9999;
        assert!(
            four.chunks_exact(4).all(bounded),
            "{channels:?}: a sum is above that of absolute values"
        );
        // Not bit for bit: a kernel with other sums is another program to the driver, and beyond 8 channels it is the host's.
        let close = |a: &[f64], b: &[f64]| {
            a.iter()
                .zip(b)
                .all(|(a, b)| (a - b).abs() <= 1e-4 * a.abs().max(1.0))
        };
        assert!(
            close(&means, &same) && close(&two, &sums),
            "{channels:?}: {means:?} became {same:?}"
        );
    }
}

#[test]
fn nothing_to_see_is_the_background() {
    let Some(gpu) = gpu() else { return };
    let camera = camera(19, 18);
    let mut behind = cloud(5, 0.1, &camera, 1);
    let forward = camera.rotation.transpose() * glam::DVec3::Z;
    for mean in behind.means.chunks_exact_mut(3) {
        mean.copy_from_slice(&(camera.center - forward * 2.0).to_array());
    }
    for scene in [Cloud::default(), behind] {
        let (got, radii) = run(&scene, RGB, &camera, &Settings::default(), &gpu, DType::F32);
        for pixel in got[0].chunks_exact(3) {
            assert_eq!(pixel, [0.3_f32, 0.9, -0.4].map(f64::from));
        }
        assert!(got[1].iter().all(|&t| t == 1.0));
        assert!(got[2..].iter().flatten().all(|&g| g == 0.0));
        assert_eq!(radii, vec![0; scene.len()]);
    }
}

#[test]
fn non_finite_input_is_named() {
    let Some(gpu) = gpu().map(Device::autodiff) else {
        return;
    };
    let camera = camera(20, 20);
    let scene = cloud(30, 0.1, &camera, 1);
    let channels = Channels {
        sh: Some((1, 1)),
        features: 2,
    };
    let names = [
        "means",
        "log_scales",
        "rotations",
        "opacity_logits",
        "sh",
        "features",
    ];
    for (part, name) in names.into_iter().enumerate() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut input = input(&scene, channels, &gpu, DType::F32);
            let spoil = |t: Tensor<2>| {
                let width = t.dims()[1];
                let mut v = t.into_data().into_vec::<f32>().expect("f32");
                v[7 * width] = bad;
                Tensor::<2>::from_data(TensorData::new(v, [30, width]), (&gpu, DType::F32))
            };
            match part {
                0 => input.means = spoil(input.means),
                1 => input.log_scales = spoil(input.log_scales),
                2 => input.rotations = spoil(input.rotations),
                3 => {
                    input.opacity_logits =
                        spoil(input.opacity_logits.reshape([30, 1])).reshape([30])
                }
                4 => {
                    input.sh = input
                        .sh
                        .map(|t| spoil(t.reshape([30, 12])).reshape([30, 4, 3]))
                }
                _ => input.features = input.features.map(spoil),
            }
            match rasterize(input, &camera, &Settings::default(), [0.0; 3]) {
                Err(Error::NonFinite { tensor, row, .. }) => {
                    assert_eq!((tensor.as_str(), row), (name, 7))
                }
                other => panic!("{name}: {other:?}"),
            }
        }
    }
}

#[test]
fn a_device_gives_the_same_bits_every_time() {
    let Some(gpu) = gpu() else { return };
    let camera = camera(65, 40);
    let scene = cloud(1_500, 0.03, &camera, 9);
    let once = || {
        run(
            &scene,
            Channels {
                sh: Some((0, 0)),
                features: 12,
            },
            &camera,
            &Settings::default(),
            &gpu,
            DType::F32,
        )
    };
    assert!(once() == once());
}

#[test]
fn a_gpu_runs_its_own_kernels() {
    let Some(gpu) = gpu() else { return };
    let camera = camera(30, 22);
    let scene = cloud(50, 0.05, &camera, 3).rounded();
    let render = |device: &Device| {
        let input = input(&scene, RGB, &device.clone().autodiff(), DType::F32);
        let out = rasterize(input, &camera, &Settings::default(), [0.1; 3]).expect("valid");
        values(out.image)
    };
    // The GPU's kernels compute geometry in f32, and so with last digits other than those of the CPU.
    assert_ne!(render(&gpu), render(&crate::support::device()));
}
