//! The same code on every backend of the build: encoder, decoder, loss and rasterizer against ndarray.

use crate::support::joined_pyramid;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use coseg::backend::device;
use coseg::backend::device::BackendName;
use coseg::config::{SpatialConfig, SpatialSource};
use coseg::raster::{RasterInput, Settings, rasterize};
use coseg::segmentation::decoder::DecoderConfig;
use coseg::segmentation::encoder::{Cloud, encode, load_spatial};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss};
use coseg::segmentation::pyramid::Switches;
use coseg::splat::Gaussians;
use glam::{DMat3, DVec3};

const POINTS: usize = 600;

/// Backends other than ndarray that work on this machine.
fn others() -> Vec<(BackendName, Device)> {
    let compiled = BackendName::compiled()
        .iter()
        .copied()
        .filter(|name| *name != BackendName::Ndarray);
    compiled
        .filter_map(|name| {
            let device = match name {
                #[cfg(feature = "wgpu")]
                BackendName::Wgpu => crate::support::gpu(),
                _ => device::open(Some(name))
                    .inspect_err(|error| eprintln!("SKIPPED: {error}"))
                    .ok(),
            };
            Some((name, device?))
        })
        .collect()
}

fn values<const D: usize>(t: Tensor<D>) -> Vec<f32> {
    t.into_data().convert::<f32>().into_vec().expect("f32")
}

fn numbers(count: usize, step: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * step).sin()).collect()
}

/// Largest difference over the root mean square of `want`.
fn relative(got: &[f32], want: &[f32]) -> f32 {
    assert_eq!(got.len(), want.len());
    assert!(got.iter().all(|v| v.is_finite()));
    let rms = (want.iter().map(|v| v * v).sum::<f32>() / want.len().max(1) as f32)
        .sqrt()
        .max(1e-12);
    got.iter()
        .zip(want)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
        / rms
}

/// Spatial features, logits, loss and the gradient of the first decoder parameter.
fn segmentation(device: &Device) -> [Vec<f32>; 4] {
    let positions: Vec<[f32; 3]> = (0..POINTS)
        .map(|i| std::array::from_fn(|a| (i as f32 * [0.37, 0.61, 0.83][a]).sin()))
        .collect();
    let config = SpatialConfig {
        source: SpatialSource::Random,
        ..SpatialConfig::default()
    };
    let (encoder, _) = load_spatial(&config, 5, device).expect("random weights");
    let cloud = Cloud {
        positions: &positions,
        colors: None,
        up: DVec3::Y,
        scale: 1.0,
    };
    let encoding = encode(&encoder, &cloud, 3, device).expect("finite");
    let image: Vec<Tensor<2>> = (0..4)
        .map(|n| {
            Tensor::from_data(
                TensorData::new(numbers(POINTS * 8, 0.13 + n as f32), [POINTS, 8]),
                device,
            )
        })
        .collect();
    let pyramid = joined_pyramid(&encoding, &image, Switches::default());
    let decoder = DecoderConfig::for_pyramid(&pyramid, 6).init(&device.clone().autodiff());
    let logits = decoder.classify(decoder.forward(&pyramid).hidden);
    let labels: Vec<u16> = (0..POINTS)
        .map(|i| if i % 7 == 6 { u16::MAX } else { (i % 6) as u16 })
        .collect();
    let loss = CoSegLoss::from(LabelLoss::Js { pi: 0.9 }).of_logits(logits.clone(), &labels);
    let gradients = loss.backward();
    struct First<'a>(&'a burn::tensor::Gradients, Option<Vec<f32>>);
    impl burn::module::ModuleVisitor for First<'_> {
        fn visit_float<const D: usize>(&mut self, param: &burn::module::Param<Tensor<D>>) {
            if self.1.is_none() {
                self.1 = param.val().grad(self.0).map(values);
            }
        }
    }
    let mut first = First(&gradients, None);
    decoder.visit(&mut first);
    let spatial = values(encoding.levels[3].features.clone());
    [
        spatial,
        values(logits.inner()),
        values(loss.inner()),
        first.1.expect("a gradient"),
    ]
}

/// An image, and the gradients of the means and of the features.
fn raster(device: &Device) -> [Vec<f32>; 3] {
    let n = 40;
    let g = Gaussians {
        means: (0..n)
            .map(|i| [0.13, 0.71, 0.29].map(|s| (i as f32 * s).sin() * 0.6))
            .collect(),
        log_scales: vec![[-2.0, -2.3, -1.8]; n],
        rotations: (0..n).map(|i| [1.0, (i as f32).sin(), 0.2, -0.3]).collect(),
        opacity_logits: numbers(n, 0.9),
        sh: numbers(n * 3, 0.31),
        sh_degree: 0,
    };
    let device = device.clone().autodiff();
    let two = |v: &[f32], c: usize| {
        Tensor::<2>::from_data(TensorData::new(v.to_vec(), [n, c]), &device).require_grad()
    };
    let means = two(g.means.as_flattened(), 3);
    let features = two(&numbers(n * 5, 0.77), 5);
    let input = RasterInput {
        means: means.clone(),
        log_scales: two(g.log_scales.as_flattened(), 3),
        rotations: two(g.rotations.as_flattened(), 4),
        opacity_logits: Tensor::from_data(TensorData::new(g.opacity_logits.clone(), [n]), &device),
        sh: Some(Tensor::from_data(
            TensorData::new(g.sh.clone(), [n, 1, 3]),
            &device,
        )),
        active_sh_degree: 0,
        features: Some(features.clone()),
        screen: None,
    };
    let camera = coseg::splat::camera::Camera {
        rotation: DMat3::IDENTITY,
        center: DVec3::new(0.0, 0.0, -2.0),
        fx: 30.0,
        fy: 30.0,
        cx: 18.5,
        cy: 14.0,
        width: 37,
        height: 29,
    };
    let out = rasterize(input, &camera, &Settings::default(), [0.1, 0.2, 0.3]).expect("valid");
    let gradients = (out.image.clone().powi_scalar(2).sum() + out.transmittance.sum()).backward();
    let grad = |t: Tensor<2>| values(t.grad(&gradients).expect("tracked"));
    [values(out.image.inner()), grad(means), grad(features)]
}

#[test]
fn encoder_decoder_and_loss_agree_with_ndarray() {
    let want = segmentation(&crate::support::device());
    for (name, device) in others() {
        for (part, (got, want)) in segmentation(&device).iter().zip(&want).enumerate() {
            let error = relative(got, want);
            assert!(error < 1e-3, "{name}, part {part}: {error}");
        }
    }
}

#[test]
fn the_rasterizer_agrees_with_ndarray() {
    let want = raster(&crate::support::device());
    for (name, device) in others() {
        for (part, (got, want)) in raster(&device).iter().zip(&want).enumerate() {
            let error = relative(got, want);
            assert!(error < 1e-4, "{name}, part {part}: {error}");
        }
    }
}
