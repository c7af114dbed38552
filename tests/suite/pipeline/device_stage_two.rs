//! Stage two on a GPU against the same on ndarray: pixels and Gaussians that take part, blending, trained identities.

use crate::support::gpu;
use crate::support::plate_runs::short;
use crate::support::plates::training_views;
use burn::tensor::{Device, Tensor, TensorData};
use coseg::config::{Blend, SegmentationConfig, Variant};
use coseg::data::{LoadOptions, load};
use coseg::pipeline::train_decoder::ViewSample;
use coseg::pipeline::{Outcome, run};
use coseg::progress::Silent;
use coseg::random::{Purpose, stream};
use std::path::Path;

#[test]
fn views_show_the_same_pixels_and_blend_alike() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let scene = load(folder.path(), &LoadOptions::default()).expect("a scene");
    let (gaussians, _) = crate::support::plates::plates();
    // All pixels of a view, or some.
    for (share, blend) in [
        (0.25, Blend::Probabilities),
        (1.0, Blend::Probabilities),
        (1.0, Blend::Logits),
        (0.25, Blend::Logits),
    ] {
        let config = SegmentationConfig {
            blend,
            ..SegmentationConfig::default()
        };
        let views = |device: &Device| training_views(&gaussians, &scene, &config, device);
        let (mut on_host, mut on_gpu) = (views(&crate::support::device()), views(&gpu));
        assert!(on_host.len() > 3);
        for index in 0..on_host.len() {
            // A view's first use, and another.
            for time in 0..2 {
                let rng = || stream(3, Purpose::Pixels, time);
                let want = on_host
                    .sample(index, Some(share), &mut rng())
                    .expect("finite");
                let got = on_gpu
                    .sample(index, Some(share), &mut rng())
                    .expect("finite");
                // A Gaussian that shows at a cut-off alone may be seen here and not there.
                let both = got
                    .visible
                    .iter()
                    .filter(|id| want.visible.contains(id))
                    .count();
                let most = got.visible.len().max(want.visible.len());
                assert!(
                    both + 1 >= most && most > 20,
                    "{both} of {most} Gaussians of view {index}"
                );
                assert_eq!(
                    got.pixels.labels, want.pixels.labels,
                    "labels of view {index}"
                );
                let count = gaussians.len();
                let (got, want) = (
                    blended(&got, count, &gpu),
                    blended(&want, count, &crate::support::device()),
                );
                for ((got, want), what) in got.iter().zip(&want).zip(["pixels", "gradient"]) {
                    assert_eq!(got.len(), want.len(), "{what} of view {index}");
                    let scale = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                    let off = got
                        .iter()
                        .zip(want)
                        .filter(|(a, b)| (*a - *b).abs() > 1e-5 * scale)
                        .count();
                    assert!(
                        off * 200 <= want.len(),
                        "{what} of view {index}: {off} of {} are off",
                        want.len()
                    );
                }
            }
        }
    }
}

/// Values that belong to the Gaussians, blended at the drawn pixels; and the gradient of a sum of these, for all `count`
/// Gaussians.
fn blended(drawn: &ViewSample, count: usize, device: &Device) -> [Vec<f32>; 2] {
    const CHANNELS: usize = 7;
    let device = device.clone().autodiff();
    let number = |i: usize, by: f32| (i as f32 * by).sin();
    let of = |&id: &u32| (0..CHANNELS).map(move |c| number(id as usize * CHANNELS + c, 0.37));
    let values = TensorData::new(
        drawn.visible.iter().flat_map(of).collect(),
        [drawn.visible.len(), CHANNELS],
    );
    let values = Tensor::<2>::from_data(values, &device).require_grad();
    let out = drawn.pixels.blend(values.clone()).expect("a device");
    let shape = out.dims();
    let towards = TensorData::new(
        (0..shape[0] * CHANNELS).map(|i| number(i, 0.71)).collect(),
        shape,
    );
    let gradients = (out.clone() * Tensor::from_data(towards, &device))
        .sum()
        .backward();
    let host = |t: Tensor<2>| {
        t.into_data()
            .convert::<f32>()
            .into_vec::<f32>()
            .expect("f32")
    };
    let mut of_all = vec![0.0; count * CHANNELS];
    let gradient = host(values.grad(&gradients).expect("tracked"));
    for (row, &id) in gradient.chunks_exact(CHANNELS).zip(drawn.visible.iter()) {
        of_all[id as usize * CHANNELS..][..CHANNELS].copy_from_slice(row);
    }
    [host(out.inner()), of_all]
}

fn trained(scene: &Path, out: &Path, device: &Device) -> Outcome {
    let rows = [Variant::Vote, Variant::PerGaussian, Variant::Ours];
    let config = short(scene, 60, &rows);
    run(&config, out, device, &mut Silent).expect("a run")
}

#[test]
fn rows_trained_on_a_gpu_learn_what_those_on_ndarray_do() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let (here, there) = (folder.path().join("here"), folder.path().join("there"));
    let want = trained(folder.path(), &here, &crate::support::device());
    // The same Gaussians: stage two alone runs on the GPU.
    std::fs::create_dir_all(there.join("checkpoint")).expect("a folder");
    let building = "checkpoint/building.safetensors";
    std::fs::copy(here.join(building), there.join(building)).expect("a copy");
    let got = trained(folder.path(), &there, &gpu);
    assert_eq!(got.gaussians.means, want.gaussians.means);
    for (got, want) in got.rows.iter().zip(&want.rows) {
        let [a, b] = [got, want].map(|row| row.identities.as_ref().expect("identities").labels());
        let same = a.iter().zip(&b).filter(|(a, b)| a == b).count() as f64 / b.len() as f64;
        let [a, b] = [got, want].map(|row| row.scores.labels.pixels.miou.expect("a score"));
        assert!(
            same > 0.98 && (a - b).abs() < 0.02,
            "{}: {same} of the labels, mIoU {a} for {b}",
            want.name()
        );
    }
}
