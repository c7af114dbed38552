//! Stage two on a GPU against the same on ndarray: pixels and Gaussians that take part, blending, trained identities.

use burn::tensor::{Device, Tensor, TensorData};
use coseg::config::{BuildingConfig, Config, Row, SegmentationConfig};
use coseg::data::{LoadOptions, Split, load};
use coseg::device::{BackendName, open};
use coseg::random::{Purpose, stream};
use coseg::raster::Settings;
use coseg::train::progress::Silent;
use coseg::train::segmentation::TrainingViews;
use coseg::train::{Outcome, run};
use std::path::Path;

/// The wgpu device, if this machine has one.
fn gpu() -> Option<Device> {
    open(Some(BackendName::Wgpu)).inspect_err(|error| eprintln!("SKIPPED: {error}")).ok()
}

#[test]
fn views_show_the_same_pixels_and_blend_alike() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    crate::plates::scene(folder.path());
    let scene = load(folder.path(), &LoadOptions::default()).expect("a scene");
    let (gaussians, _) = crate::plates::plates();
    // With and without room for the Gaussians that a view shows.
    for budget in [1 << 20, 0] {
        let views = |device: &Device| {
            let train = scene.split(Split::Train);
            TrainingViews::new(&gaussians, train, &scene.classes, Settings::default(), 0.5, budget, device)
        };
        let (mut on_host, mut on_gpu) = (views(&crate::device()), views(&gpu));
        assert!(on_host.len() > 3);
        for index in 0..on_host.len() {
            // A view's first use, and another.
            for time in 0..2 {
                let rng = || stream(3, Purpose::Pixels, time);
                let want = on_host.draw(index, 0.25, &mut rng()).expect("finite");
                let got = on_gpu.draw(index, 0.25, &mut rng()).expect("finite");
                assert_eq!(got.visible, want.visible, "Gaussians of view {index}");
                assert_eq!(got.pixels.labels, want.pixels.labels, "labels of view {index}");
                let blend = |drawn: &coseg::train::segmentation::Drawn, device: &Device| {
                    let (rows, channels) = (drawn.visible.len(), 7);
                    let numbers = |n: usize, by: f32| (0..n).map(|i| (i as f32 * by).sin()).collect::<Vec<f32>>();
                    let device = device.clone().autodiff();
                    let values = TensorData::new(numbers(rows * channels, 0.37), [rows, channels]);
                    let values = Tensor::<2>::from_data(values, &device).require_grad();
                    let out = drawn.pixels.blend(values.clone()).expect("a device");
                    let shape = out.dims();
                    let towards = TensorData::new(numbers(shape[0] * shape[1], 0.71), shape);
                    let gradients = (out.clone() * Tensor::from_data(towards, &device)).sum().backward();
                    let host = |t: Tensor<2>| t.into_data().convert::<f32>().into_vec::<f32>().expect("f32");
                    [host(out.inner()), host(values.grad(&gradients).expect("tracked"))]
                };
                let (got, want) = (blend(&got, &gpu), blend(&want, &crate::device()));
                for ((got, want), what) in got.iter().zip(&want).zip(["pixels", "gradient"]) {
                    assert_eq!(got.len(), want.len(), "{what} of view {index}");
                    let scale = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                    let worst = got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                    assert!(worst <= 1e-5 * scale, "{what} of view {index}: {worst} of {scale}");
                }
            }
        }
    }
}

fn trained(scene: &Path, out: &Path, device: &Device) -> Outcome {
    let mut config = Config {
        building: BuildingConfig { iterations: 40, random_points: 400, ..BuildingConfig::default() },
        segmentation: SegmentationConfig {
            iterations: 60,
            rows: vec![Row::Vote, Row::PerGaussian, Row::Ours],
            ..SegmentationConfig::default()
        },
        ..Config::default()
    };
    config.data.dir = Some(scene.to_owned());
    run(&config, out, device, &mut Silent).expect("a run")
}

#[test]
fn rows_trained_on_a_gpu_learn_what_those_on_ndarray_do() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    crate::plates::scene(folder.path());
    let (here, there) = (folder.path().join("here"), folder.path().join("there"));
    let want = trained(folder.path(), &here, &crate::device());
    // The same Gaussians: stage two alone runs on the GPU.
    std::fs::create_dir_all(there.join("checkpoint")).expect("a folder");
    let building = "checkpoint/building.safetensors";
    std::fs::copy(here.join(building), there.join(building)).expect("a copy");
    let got = trained(folder.path(), &there, &gpu);
    assert_eq!(got.gaussians.means, want.gaussians.means);
    for (got, want) in got.rows.iter().zip(&want.rows) {
        let [a, b] = [got, want].map(|row| row.identities.as_ref().expect("identities").labels());
        let same = a.iter().zip(&b).filter(|(a, b)| a == b).count() as f64 / b.len() as f64;
        let [a, b] = [got, want].map(|row| row.scores.miou.expect("a score"));
        assert!(same > 0.98 && (a - b).abs() < 0.02, "{}: {same} of the labels, mIoU {a} for {b}", want.name());
    }
}
