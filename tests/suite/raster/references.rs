//! The rasterizer against its reference in plain tensors: values, and gradients by burn's autodiff, in f64.

use crate::support::raster_reference::{Cloud, camera, cloud, numbers};
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::ops::{CustomOp, with_references};
use coseg::raster::{RasterInput, Settings, SplatTensors, rasterize};

const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 1e-14,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

/// Settings whose cap, cut-off and end of a pixel all occur.
const CUT: Settings = Settings {
    alpha_max: 0.6,
    alpha_min: 1.0 / 255.0,
    t_min: 0.05,
    near: 0.01,
    low_pass: 0.3,
};

fn tensor<const D: usize>(values: &[f64], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(
        TensorData::new(values.to_vec(), shape),
        (device, DType::F64),
    )
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().into_vec().expect("f64")
}

/// Gaussians around the view, with one behind the camera, one on a zero quaternion, a huge one and a plate.
fn awkward() -> Cloud {
    let camera = camera(33, 27);
    let mut cloud = cloud(40, 0.05, &camera, 17);
    let at = |depth: f64| (camera.center + camera.ray(16.0, 12.0) * depth).to_array();
    cloud.push(at(-2.0), [0.1; 3], [1.0, 0.0, 0.0, 0.0], 1.0);
    cloud.push(at(2.2), [0.1, 0.2, 0.3], [0.0; 4], 0.5);
    cloud.push(at(4.0), [3.0, 2.0, 2.5], [3.0, 40.0, -25.0, 11.0], -1.0);
    cloud.push(at(3.0), [1e-3, 0.2, 0.3], [0.3, -0.5, 0.8, 0.1], 2.0);
    cloud
}

/// Agreement within `tolerance` of the largest value.
fn assert_close(what: &str, got: &[f64], want: &[f64], tolerance: f64) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    assert!(largest > 0.0 || got.is_empty(), "{what}: all zero");
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        let off = (got - want).abs();
        assert!(off <= tolerance * largest, "{what}, {i}: {got} for {want}");
    }
}

#[test]
fn rendering_and_all_gradients_equal_the_reference() {
    let device = crate::support::device().autodiff();
    let camera = camera(33, 27);
    let cloud = awkward();
    let n = cloud.len();
    for (settings, degree, active, features) in [
        (SMOOTH, 3, 3, 2),
        (CUT, 2, 1, 0),
        (Settings::default(), 0, 0, 9),
    ] {
        let terms = (degree + 1) * (degree + 1);
        let run = || {
            let leaf = |values: &[f64], width| tensor(values, [n, width], &device).require_grad();
            let sh = tensor(&numbers(n * terms * 3, 5), [n, terms, 3], &device);
            let input = RasterInput {
                means: leaf(&cloud.means, 3),
                log_scales: leaf(&cloud.log_scales, 3),
                rotations: leaf(&cloud.rotations, 4),
                opacity_logits: tensor(&cloud.opacity_logits, [n], &device).require_grad(),
                sh: Some(sh.require_grad()),
                active_sh_degree: active,
                features: (features > 0).then(|| leaf(&numbers(n * features, 6), features)),
                screen: Some(leaf(&numbers(n * 2, 7), 2)),
            };
            let out = rasterize(input.clone(), &camera, &settings, [0.3, 0.9, 0.1]).expect("valid");
            let [h, w, c] = out.image.dims();
            let towards = tensor(&numbers(h * w * c, 8), [h, w, c], &device);
            let through = tensor(&numbers(h * w, 9), [h, w], &device);
            let loss =
                (out.image.clone() * towards).sum() + (out.transmittance.clone() * through).sum();
            let grads = loss.backward();
            macro_rules! grad {
                ($name:literal, $tensor:expr) => {
                    ($name, host($tensor.grad(&grads).expect("tracked")))
                };
            }
            let mut all = vec![
                ("image", host(out.image.inner())),
                ("transmittance", host(out.transmittance.inner())),
                ("radii", host(out.radii)),
                grad!("means", input.means),
                grad!("log_scales", input.log_scales),
                grad!("rotations", input.rotations),
                grad!("opacity_logits", input.opacity_logits),
                grad!("sh", input.sh.expect("given")),
                grad!("screen", input.screen.expect("given")),
            ];
            all.extend(input.features.map(|features| grad!("features", features)));
            all
        };
        for ((name, got), (_, want)) in run().into_iter().zip(with_references(&CustomOp::ALL, run))
        {
            let what = format!("{name} at degree {degree}");
            assert_close(&what, &got, &want, 1e-9);
        }
    }
}

#[test]
fn frozen_blending_and_its_adjoint_equal_the_reference() {
    let device = crate::support::device();
    let camera = camera(33, 27);
    let cloud = awkward();
    let n = cloud.len();
    let splats = SplatTensors {
        means: tensor(&cloud.means, [n, 3], &device),
        log_scales: tensor(&cloud.log_scales, [n, 3], &device),
        rotations: tensor(&cloud.rotations, [n, 4], &device),
        opacity_logits: tensor(&cloud.opacity_logits, [n], &device),
    };
    for settings in [SMOOTH, CUT, Settings::default()] {
        for channels in [1, 3, 14] {
            let run = || {
                let view = splats.seen_by(&camera, &settings);
                let device = device.clone().autodiff();
                let values =
                    tensor(&numbers(n * channels, 5), [n, channels], &device).require_grad();
                let (image, transmittance) = view.blend(values.clone()).expect("valid");
                let shape = image.dims();
                let y = numbers(shape.iter().product(), 8);
                let loss = (image.clone() * tensor(&y, shape, &device)).sum();
                let gradient = values.grad(&loss.backward()).expect("tracked");
                let sums = view.blend_adjoint(tensor(&y, shape, &device.inner()));
                let counts = view.disc_pixels().expect("valid");
                [
                    ("image", host(image.inner())),
                    ("transmittance", host(transmittance.inner())),
                    ("gradient", host(gradient)),
                    ("sums", host(sums.expect("valid"))),
                    ("counts", counts.into_iter().map(f64::from).collect()),
                ]
            };
            for ((name, got), (_, want)) in
                run().into_iter().zip(with_references(&CustomOp::ALL, run))
            {
                assert_close(&format!("{name} of {channels}"), &got, &want, 1e-9);
            }
        }
    }
}

/// Blending is linear in the values, so a difference is exact whatever its step.
#[test]
fn the_gradient_of_frozen_blending_equals_finite_differences() {
    const CHANNELS: usize = 4;
    let device = crate::support::device();
    let camera = camera(9, 7);
    let cloud = cloud(6, 0.08, &camera, 9);
    let n = cloud.len();
    let view = SplatTensors {
        means: tensor(&cloud.means, [n, 3], &device),
        log_scales: tensor(&cloud.log_scales, [n, 3], &device),
        rotations: tensor(&cloud.rotations, [n, 4], &device),
        opacity_logits: tensor(&cloud.opacity_logits, [n], &device),
    }
    .seen_by(&camera, &CUT);
    let device = device.autodiff();
    let shape = [camera.height, camera.width, CHANNELS];
    let y = tensor(&numbers(shape.iter().product(), 8), shape, &device);
    let loss = |values: &[f64]| {
        let values = tensor(values, [n, CHANNELS], &device).require_grad();
        let (image, _) = view.blend(values.clone()).expect("valid");
        (values, (image * y.clone()).sum())
    };
    let at = numbers(n * CHANNELS, 5);
    let (values, sum) = loss(&at);
    let gradient = host(values.grad(&sum.backward()).expect("tracked"));
    let differences: Vec<f64> = (0..at.len())
        .map(|i| {
            let moved = |by: f64| {
                let mut values = at.clone();
                values[i] += by;
                host(loss(&values).1.inner())[0]
            };
            0.5 * (moved(1.0) - moved(-1.0))
        })
        .collect();
    assert!(differences.iter().any(|difference| difference.abs() > 1e-3));
    assert_close("gradient", &gradient, &differences, 1e-9);
}
