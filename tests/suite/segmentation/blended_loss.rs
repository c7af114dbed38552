//! The label loss of blended class probabilities, and Eq. 9: values, gradients, hard cases, any number of threads.

use burn::tensor::activation::softmax;
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::ops::SparseMatrix;
use coseg::segmentation::loss::{
    CoSegLoss, LabelLoss, NeighbourPairs, Scores, neighbour_divergence,
};
use coseg::segmentation::pixels::{LabelledPixels, NO_CLASS, PixelWeights};
use std::sync::Arc;

const KINDS: [LabelLoss; 5] = [
    LabelLoss::Ce,
    LabelLoss::Gce { q: 0.7 },
    LabelLoss::Gce { q: 1.0 },
    LabelLoss::Js { pi: 0.9 },
    LabelLoss::Js { pi: 0.99 },
];

fn device() -> Device {
    crate::support::device().autodiff()
}

fn waves(count: usize, step: f64) -> Vec<f64> {
    (0..count).map(|i| (i as f64 * step + 0.3).sin()).collect()
}

fn tensor<const D: usize>(values: Vec<f64>, shape: [usize; D], dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), (&device(), dtype)).require_grad()
}

fn host<const D: usize>(t: Tensor<D>) -> Vec<f64> {
    t.into_data().convert::<f64>().into_vec().expect("f64")
}

/// `[rows, columns]` with `k` entries a row that sum to 1.
fn mixing(rows: usize, columns: usize, k: usize) -> SparseMatrix {
    let indices = (0..rows * k)
        .map(|i| ((i * 7 + i / k * 3) % columns) as u32)
        .collect();
    let raw: Vec<f32> = (0..rows * k)
        .map(|i| 1.0 + (i as f32 * 0.7).sin())
        .collect();
    let values = raw
        .chunks_exact(k)
        .flat_map(|row| row.iter().map(|v| v / row.iter().sum::<f32>()))
        .collect();
    SparseMatrix::new(
        columns,
        (0..=rows).map(|r| (r * k) as u32).collect(),
        indices,
        values,
    )
}

fn assert_close(got: &[f64], want: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let scale = want.iter().fold(1e-3_f64, |m, v| m.max(v.abs()));
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        assert!(
            (got - want).abs() <= tolerance * scale,
            "{what} {i}: {got} for {want}, of {scale}"
        );
    }
}

/// 5 classes, of which one labels nothing; some pixels are unlabelled.
fn pixels(rows: usize, points: usize) -> Arc<LabelledPixels> {
    let chosen: Vec<u32> = (0..rows as u32).filter(|r| r % 3 != 1).collect();
    let label = |&r: &u32| {
        if r % 11 == 5 {
            NO_CLASS
        } else {
            [0, 1, 2, 4][(r / 2 % 4) as usize]
        }
    };
    let labels = chosen.iter().map(label).collect();
    let weights = mixing(rows, points, 4).select_rows(&chosen);
    Arc::new(LabelledPixels::new(
        PixelWeights::Stored(Arc::new(weights)),
        labels,
    ))
}

/// The loss and its gradient. `all` blends the probabilities of all classes, and reads the mixture as logits.
fn blended(
    all: bool,
    scores: &[f64],
    pixels: &Arc<LabelledPixels>,
    loss: &CoSegLoss,
    dtype: DType,
) -> [Vec<f64>; 2] {
    let scores = tensor(scores.to_vec(), [scores.len() / 5, 5], dtype);
    let value = if all {
        let mixture = pixels.blend(softmax(scores.clone(), 1)).expect("stored");
        loss.of_logits((mixture + 1e-8).log(), &pixels.labels)
    } else {
        loss.forward(Scores::Gaussians(scores.clone()), pixels, None)
            .expect("stored weights")
    };
    // a factor, as in a sum of losses
    let gradients = (value.clone() * 3.0).backward();
    [host(value), host(scores.grad(&gradients).expect("tracked"))]
}

/// Each loss alike for all classes, and softened for some.
fn losses() -> Vec<CoSegLoss> {
    let for_all = KINDS.into_iter().map(CoSegLoss::from);
    let softened = KINDS.into_iter().map(|label| CoSegLoss {
        robustness: vec![1.0, 0.4, 0.0],
        ..label.into()
    });
    for_all.chain(softened).collect()
}

#[test]
fn the_own_class_alone_gives_the_loss_of_all_classes() {
    for (rows, points) in [(20, 7), (40_000, 90)] {
        let pixels = pixels(rows, points);
        let scores: Vec<f64> = waves(points * 5, 1.3).iter().map(|v| 3.0 * v).collect();
        for kind in losses() {
            let [got, want] =
                [false, true].map(|all| blended(all, &scores, &pixels, &kind, DType::F64));
            // rows of f32 weights sum to 1 within 1e-7, and the other form sees what is missing
            assert_close(&got[0], &want[0], 1e-7, &format!("{kind:?}, {rows} rows"));
            assert_close(
                &got[1],
                &want[1],
                1e-6,
                &format!("{kind:?}, {rows} rows: gradient"),
            );
        }
    }
}

#[test]
fn blended_label_loss_has_the_gradient_of_finite_differences() {
    let pixels = pixels(20, 7);
    let scores = waves(7 * 5, 2.1);
    let value =
        |scores: &[f64], kind: &CoSegLoss| blended(false, scores, &pixels, kind, DType::F64)[0][0];
    for kind in &losses() {
        let gradient = &blended(false, &scores, &pixels, kind, DType::F64)[1];
        let finite: Vec<f64> = (0..scores.len())
            .map(|i| {
                let moved = |by: f64| {
                    let mut scores = scores.clone();
                    scores[i] += by;
                    value(&scores, kind)
                };
                3.0 * (moved(1e-5) - moved(-1e-5)) / 2e-5
            })
            .collect();
        assert_close(gradient, &finite, 1e-7, &format!("{kind:?}"));
    }
}

#[test]
fn blended_label_loss_survives_certainty_and_emptiness() {
    let pixels = pixels(20, 7);
    let scores: Vec<f64> = waves(7 * 5, 2.1).iter().map(|v| 300.0 * v).collect();
    for kind in losses() {
        let [value, gradient] = blended(false, &scores, &pixels, &kind, DType::F32);
        assert!(
            value.iter().chain(&gradient).all(|v| v.is_finite()),
            "{kind:?}"
        );
        assert!(
            value[0] > 0.1,
            "certain and wrong in places, and it must cost: {}",
            value[0]
        );
    }
    let labels = Arc::new(vec![NO_CLASS; pixels.len()]);
    let nothing = Arc::new(LabelledPixels {
        labels,
        ..(*pixels).clone()
    });
    let [value, gradient] = blended(false, &scores, &nothing, &LabelLoss::Ce.into(), DType::F32);
    assert!(value[0] == 0.0 && gradient.iter().all(|g| *g == 0.0));
}

#[test]
fn blended_label_loss_has_the_same_bits_at_any_number_of_threads() {
    let pixels = pixels(60_000, 500);
    let scores = waves(2500, 0.77);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            blended(
                false,
                &scores,
                &pixels,
                &LabelLoss::Js { pi: 0.9 }.into(),
                DType::F32,
            )
        })
    };
    assert_eq!(run(1), run(2));
}

/// Eq. 9 and its gradient; some rows are their own neighbours' neighbours.
fn divergence(dtype: DType) -> [Vec<f64>; 2] {
    let (points, width, k) = (1500, 6, 3);
    let values = waves(points * width, 0.83)
        .iter()
        .map(|v| 2.0 * v)
        .collect();
    let features = tensor(values, [points, width], dtype);
    let chosen = (0..1400).map(|i| i * 7 % 1500).collect();
    let table: Vec<u32> = (0..(points * k) as u32)
        .map(|i| (i / 3 + 1 + i % 3 * 5) % 1500)
        .collect();
    let value = neighbour_divergence(features.clone(), &NeighbourPairs::new(chosen, &table, k));
    let gradients = (value.clone() * 2.0).backward();
    [
        host(value),
        host(features.grad(&gradients).expect("tracked")),
    ]
}

#[test]
fn neighbour_divergence_has_the_same_bits_at_any_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| divergence(DType::F32))
    };
    let (one, two) = (run(1), run(2));
    assert!(one[0][0] > 0.1);
    assert_eq!(one, two);
    let exact = divergence(DType::F64);
    assert_close(&one[0], &exact[0], 1e-5, "divergence");
    assert_close(&one[1], &exact[1], 1e-4, "its gradient");
}
