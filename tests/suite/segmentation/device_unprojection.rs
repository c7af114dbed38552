//! The adjoint of blending and the unprojection on a GPU against the CPU's, fed the same f32 numbers.

use crate::support::gpu;
use crate::support::lifting::unproject;
use crate::support::raster_reference::{Cloud, camera, cloud, numbers};
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::Error;
use coseg::config::{Normalisation, UnprojectionConfig};
use coseg::data::View;
use coseg::data::mask::Mask;
use coseg::features::{FeatureMap, Steps};
use coseg::raster::{RasterInput, Settings, SplatTensors, rasterize};
use coseg::segmentation::unprojection::attended;
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;
use glam::DVec3;

fn host<const D: usize>(t: Tensor<D>) -> Vec<f64> {
    t.into_data().convert::<f64>().into_vec().expect("floats")
}

fn tensor<const D: usize>(
    values: &[f64],
    shape: [usize; D],
    device: &Device,
    dtype: DType,
) -> Tensor<D> {
    let narrow: Vec<f64> = values.iter().map(|&v| f64::from(v as f32)).collect();
    Tensor::from_data(TensorData::new(narrow, shape), (device, dtype))
}

fn splats(cloud: &Cloud, device: &Device, dtype: DType) -> SplatTensors {
    let n = cloud.len();
    SplatTensors {
        means: tensor(&cloud.means, [n, 3], device, dtype),
        log_scales: tensor(&cloud.log_scales, [n, 3], device, dtype),
        rotations: tensor(&cloud.rotations, [n, 4], device, dtype),
        opacity_logits: tensor(&cloud.opacity_logits, [n], device, dtype),
    }
}

const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 1e-14,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

#[test]
fn the_adjoint_of_blending() {
    let Some(gpu) = gpu() else { return };
    for (count, width, height, settings) in [
        (1, 5, 3, SMOOTH),
        (60, 37, 29, SMOOTH),
        (400, 160, 90, Settings::default()),
    ] {
        let camera = camera(width, height);
        let cloud = cloud(count, 0.04, &camera, 11);
        for channels in [1, 3, 4, 12, 13, 65] {
            let y = numbers(width * height * channels, 5);
            let run = |device: &Device, dtype| {
                let image = tensor(&y, [height, width, channels], device, dtype);
                let view = splats(&cloud, device, dtype).seen_by(&camera, &settings);
                let sums = view.blend_adjoint(image).expect("valid");
                (host(sums), view.disc_pixels().expect("valid"))
            };
            let (want, want_counts) = run(&crate::support::device(), DType::F64);
            let (got, got_counts) = run(&gpu, DType::F32);
            let what = format!("{count} Gaussians, {channels} channels");
            assert_eq!(got.len(), want.len());
            assert_eq!(got_counts.len(), count);
            let largest = want.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let off = got
                .iter()
                .zip(&want)
                .filter(|(g, w)| (*g - *w).abs() > 1e-5 * largest)
                .count();
            // A pair on the cut-off may go either way; SMOOTH has none.
            let allowed = if settings == SMOOTH {
                0
            } else {
                want.len() / 500
            };
            assert!(off <= allowed, "{what}: {off} of {} are off", want.len());
            // So may a pixel on the rim of the radius, and a radius that is a whole number apart from rounding.
            let differ = got_counts
                .iter()
                .zip(&want_counts)
                .filter(|(g, w)| g != w)
                .count();
            assert!(differ * 50 <= count, "{what}: {differ} counts differ");
            assert!(want_counts.iter().any(|c| *c > 0));
        }
    }
}

#[test]
fn frozen_geometry_renders_and_learns_features_as_learned_geometry_does() {
    let Some(gpu) = gpu() else { return };
    let camera = camera(64, 48);
    let device = gpu.clone().autodiff();
    let cloud = cloud(300, 0.05, &camera, 3);
    let settings = Settings::default();
    let features =
        || tensor::<2>(&numbers(300 * 21, 8), [300, 21], &device, DType::F32).require_grad();
    let finish = |image: Tensor<3>, features: Tensor<2>| {
        let towards = tensor::<3>(&numbers(48 * 64 * 21, 9), [48, 64, 21], &device, DType::F32);
        let gradients = (image.clone() * towards).sum().backward();
        [
            host(image.inner()),
            host(features.grad(&gradients).expect("tracked")),
        ]
    };
    let SplatTensors {
        means,
        log_scales,
        rotations,
        opacity_logits,
    } = splats(&cloud, &device, DType::F32);
    let of_learned = features();
    let input = RasterInput {
        means: means.require_grad(),
        log_scales,
        rotations,
        opacity_logits,
        sh: None,
        active_sh_degree: 0,
        features: Some(of_learned.clone()),
        screen: None,
    };
    let out = rasterize(input, &camera, &settings, [0.0; 3]).expect("valid");
    let transmittance = host(out.transmittance.inner());
    let learned = finish(out.image, of_learned);
    let view = splats(&cloud, &gpu, DType::F32).seen_by(&camera, &settings);
    // Lists that are made at the first use serve the second.
    for _ in 0..2 {
        let of_frozen = features();
        let (image, left) = view.blend(of_frozen.clone()).expect("valid");
        assert_eq!(host(left.inner()), transmittance);
        for ((frozen, learned), what) in finish(image, of_frozen)
            .iter()
            .zip(&learned)
            .zip(["image", "gradient"])
        {
            let largest = learned.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let worst = frozen
                .iter()
                .zip(learned)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            assert!(worst < 1e-6 * largest, "{what}: {worst} of {largest}");
        }
    }
    let error = view
        .blend(Tensor::zeros([299, 2], &gpu))
        .expect_err("a row is missing");
    crate::support::assert_names(&error, &["values to blend", "299", "300"]);
}

#[test]
fn what_cannot_be_lifted_is_refused() {
    let mut devices = vec![crate::support::device()];
    devices.extend(gpu());
    for device in devices {
        let camera = camera(20, 10);
        let cloud = cloud(5, 0.05, &camera, 3);
        let image = |height| Tensor::<3>::ones([height, 20, 2], &device);
        let view = |cloud: &Cloud| {
            let splats = splats(cloud, &device, DType::F32);
            splats.seen_by(&camera, &Settings::default())
        };
        let lift = |cloud: &Cloud, height| view(cloud).blend_adjoint(image(height));
        let error = lift(&cloud, 11).expect_err("another size");
        crate::support::assert_names(&error, &["20x11", "20x10"]);
        let mut spoilt = cloud.clone();
        spoilt.log_scales[4] = f64::NAN;
        let error = lift(&spoilt, 10).expect_err("a NaN");
        assert!(matches!(error, Error::NonFinite { row: 1, .. }), "{error}");
        let error = view(&spoilt).disc_pixels().expect_err("a NaN");
        assert!(matches!(error, Error::NonFinite { row: 1, .. }), "{error}");
        let mut uneven = splats(&cloud, &device, DType::F32);
        uneven.rotations = tensor(&[0.0; 16], [4, 4], &device, DType::F32);
        let error = uneven
            .seen_by(&camera, &Settings::default())
            .blend_adjoint(image(10))
            .expect_err("a row is missing");
        crate::support::assert_names(&error, &["frozen Gaussians", "[4, 4]"]);
        let none = view(&Cloud::default());
        assert_eq!(
            none.blend_adjoint(image(10)).expect("nothing").dims(),
            [0, 2]
        );
        assert!(none.disc_pixels().expect("nothing").is_empty());
    }
}

#[test]
fn features_are_lifted_alike() {
    let Some(gpu) = gpu() else { return };
    let camera = camera(96, 64);
    let n = 300;
    let of = cloud(n, 0.05, &camera, 17);
    let rows = |values: &[f64]| {
        values
            .as_chunks::<3>()
            .0
            .iter()
            .map(|row| row.map(|v| v as f32))
            .collect()
    };
    let gaussians = Gaussians {
        means: rows(&of.means),
        log_scales: rows(&of.log_scales),
        rotations: of
            .rotations
            .as_chunks::<4>()
            .0
            .iter()
            .map(|row| row.map(|v| v as f32))
            .collect(),
        opacity_logits: of.opacity_logits.iter().map(|&v| v as f32).collect(),
        sh: vec![0.0; 3 * n],
        sh_degree: 0,
    };
    let mut masked = views_of(&camera);
    // A wall and single pixels of one view, most of another.
    masked[0].mask = Some(Mask::new(96, 64, |i| i % 96 > 30 && i % 17 > 0));
    masked[2].mask = Some(Mask::new(96, 64, |i| i / 96 < 20));
    // As large as the image, dividing it evenly, at fixed steps, and coarse.
    let maps = |i: usize| {
        [
            (96, 64, None),
            (24, 16, None),
            (
                13,
                9,
                Some(Steps {
                    stride: 8.0,
                    offset: 0.5,
                }),
            ),
            (5, 3, None),
        ]
        .map(|(width, height, steps)| FeatureMap {
            width,
            height,
            channels: 6,
            data: numbers(width * height * 6, i as u64 + 31)
                .into_iter()
                .map(|v| v as f32)
                .collect(),
            steps,
        })
    };
    let set = crate::support::feature_maps::features(&masked, maps);
    for views in [views_of(&camera), masked.clone()] {
        for normalisation in [Normalisation::Weight, Normalisation::Count] {
            let lift = |device: &Device| {
                let lifted = unproject(&gaussians, views.iter(), &set, normalisation, device);
                lifted.expect("features")
            };
            let (got, want) = (lift(&gpu), lift(&crate::support::device()));
            for (scale, (got, want)) in got.iter().zip(&want).enumerate() {
                assert_eq!(got.len(), want.len());
                let largest = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                let off = got
                    .iter()
                    .zip(want)
                    .filter(|(g, w)| (*g - *w).abs() > 1e-4 * largest)
                    .count();
                assert!(
                    off * 200 <= want.len(),
                    "{normalisation:?}, scale {scale}: {off} are off"
                );
            }
        }
        let config = UnprojectionConfig {
            attendance: 0.02,
            attendance_pixels: 0.0,
            ..UnprojectionConfig::default()
        };
        let kept = |device: &Device| {
            let settings = Settings::default();
            let go_on = &mut || Ok(());
            let kept = attended(&gaussians, views.iter(), &config, &settings, device, go_on);
            kept.expect("counts")
        };
        let (got, want) = (kept(&gpu), kept(&crate::support::device()));
        let same = got.iter().zip(&want).filter(|(a, b)| a == b).count();
        assert!(same * 100 >= n * 98, "{same} of {n} kept alike");
        assert!(want.contains(&true) && want.contains(&false));
    }
}

/// The view of `camera`, and two from beside it.
fn views_of(camera: &Camera) -> Vec<View> {
    let moved = |x: f64| Camera {
        center: camera.center + DVec3::new(x, 0.0, 0.0),
        ..camera.clone()
    };
    [0.0, 0.3, -0.4]
        .into_iter()
        .enumerate()
        .map(|(i, x)| crate::support::feature_maps::view(format!("v{i}"), moved(x)))
        .collect()
}
