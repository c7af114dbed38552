//! Fused operations of stage two against their plain forms, in f64, and at any number of threads.

use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use coseg::ops::{
    ClassLosses, Kind, LabelledPixels, LayerMap, NeighbourPairs, PixelWeights, SparseMatrix,
    UNLABELLED, blended_label_loss, blended_label_loss_plain, fusion_layer, fusion_layer_plain,
    neighbour_divergence, neighbour_divergence_plain,
};
use std::sync::Arc;

const KINDS: [Kind; 6] = [
    Kind::Ce,
    Kind::Mae,
    Kind::Gce { q: 0.7 },
    Kind::Js { pi_rl: 0.9 },
    Kind::Js { pi_rl: 0.99 },
    Kind::NceRce,
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

/// A layer of `rows` out of `all` rows: output, and the gradients of all four tensors.
fn layer(
    fused: bool,
    [all, inputs, coarse, width]: [usize; 4],
    map: &LayerMap,
    dtype: DType,
) -> [Vec<f64>; 5] {
    let x = tensor(waves(all * inputs, 0.37), [all, inputs], dtype);
    let weight = tensor(waves(inputs * width, 0.11), [inputs, width], dtype);
    let below = tensor(waves(coarse * width, 0.53), [coarse, width], dtype);
    let bias = tensor(waves(width, 0.9), [width], dtype);
    let parts = (x.clone(), weight.clone(), below.clone(), bias.clone());
    let out = match fused {
        true => fusion_layer(parts.0, parts.1, parts.2, parts.3, map.clone()),
        false => fusion_layer_plain(parts.0, parts.1, parts.2, parts.3, map),
    };
    let shape = out.dims();
    let towards = Tensor::from_data(
        TensorData::new(waves(shape[0] * shape[1], 0.29), shape),
        (&device(), dtype),
    );
    let gradients = (out.clone() * towards).sum().backward();
    fn of<const D: usize>(t: &Tensor<D>, gradients: &Gradients) -> Vec<f64> {
        t.grad(gradients).map(host).unwrap_or_default()
    }
    let of_x = if inputs == 0 {
        Vec::new()
    } else {
        of(&x, &gradients)
    };
    let of_weight = if inputs == 0 {
        Vec::new()
    } else {
        of(&weight, &gradients)
    };
    [
        host(out),
        of_x,
        of_weight,
        of(&below, &gradients),
        of(&bias, &gradients),
    ]
}

#[test]
fn fusion_layer_equals_its_plain_form() {
    // the last one needs several parts and blocks that are not full
    for (all, inputs, coarse, width, picked) in [
        (5, 3, 2, 4, false),
        (9, 3, 4, 7, true),
        (40, 0, 11, 5, true),
        (4200, 6, 100, 3, true),
    ] {
        let rows: Option<Vec<u32>> =
            picked.then(|| (0..all as u32).rev().filter(|r| r % 5 != 1).collect());
        let used = rows.as_ref().map_or(all, Vec::len);
        for slope in [0.2, 1.0] {
            let upsample = Arc::new(mixing(used, coarse, 2));
            let map = LayerMap {
                rows: rows.clone().map(|rows| Arc::new(rows.into())),
                upsample,
                slope,
            };
            let [got, want] = [true, false]
                .map(|fused| layer(fused, [all, inputs, coarse, width], &map, DType::F64));
            let names = [
                "output",
                "gradient of x",
                "of the weight",
                "of below",
                "of the bias",
            ];
            for ((got, want), name) in got.iter().zip(&want).zip(names) {
                assert_close(
                    got,
                    want,
                    1e-11,
                    &format!("{all} rows, slope {slope}: {name}"),
                );
            }
        }
    }
}

#[test]
fn fusion_layer_has_the_same_bits_at_any_number_of_threads() {
    let map = LayerMap {
        rows: None,
        upsample: Arc::new(mixing(5000, 300, 3)),
        slope: 0.2,
    };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| layer(true, [5000, 19, 300, 16], &map, DType::F32))
    };
    assert_eq!(run(1), run(2));
}

/// 5 classes, of which one labels nothing; some pixels are unlabelled.
fn pixels(rows: usize, points: usize) -> Arc<LabelledPixels> {
    let chosen: Vec<u32> = (0..rows as u32).filter(|r| r % 3 != 1).collect();
    let label = |&r: &u32| {
        if r % 11 == 5 {
            UNLABELLED
        } else {
            [0, 1, 2, 4][(r / 2 % 4) as usize]
        }
    };
    let labels = chosen.iter().map(label).collect();
    Arc::new(LabelledPixels::new(
        PixelWeights::Stored(Arc::new(mixing(rows, points, 4))),
        chosen,
        labels,
    ))
}

fn blended(
    fused: bool,
    scores: &[f64],
    pixels: &Arc<LabelledPixels>,
    losses: &ClassLosses,
    dtype: DType,
) -> [Vec<f64>; 2] {
    let scores = tensor(scores.to_vec(), [scores.len() / 5, 5], dtype);
    let loss = match fused {
        true => blended_label_loss(scores.clone(), pixels.clone(), losses),
        false => blended_label_loss_plain(scores.clone(), pixels, losses),
    }
    .expect("stored weights");
    // a factor, as in a sum of losses
    let gradients = (loss.clone() * 3.0).backward();
    [host(loss), host(scores.grad(&gradients).expect("tracked"))]
}

/// Each loss alike for all classes, and softened for some.
fn losses() -> Vec<ClassLosses> {
    let shares = vec![1.0, 0.4, 0.0];
    let for_all = KINDS.into_iter().map(ClassLosses::from);
    for_all
        .chain(KINDS.into_iter().map(|kind| ClassLosses {
            kind,
            shares: shares.clone(),
        }))
        .collect()
}

#[test]
fn blended_label_loss_equals_its_plain_form() {
    for (rows, points) in [(20, 7), (40_000, 90)] {
        let pixels = pixels(rows, points);
        let scores: Vec<f64> = waves(points * 5, 1.3).iter().map(|v| 3.0 * v).collect();
        for kind in losses() {
            let [got, want] =
                [true, false].map(|fused| blended(fused, &scores, &pixels, &kind, DType::F64));
            // rows of f32 weights sum to 1 within 1e-7, and the plain form sees what is missing
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
        |scores: &[f64], kind: &ClassLosses| blended(true, scores, &pixels, kind, DType::F64)[0][0];
    for kind in &losses() {
        let gradient = &blended(true, &scores, &pixels, kind, DType::F64)[1];
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
        let [value, gradient] = blended(true, &scores, &pixels, &kind, DType::F32);
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
    let labels = Arc::new(vec![UNLABELLED; pixels.rows.len()].into());
    let nothing = Arc::new(LabelledPixels {
        labels,
        ..(*pixels).clone()
    });
    let [value, gradient] = blended(true, &scores, &nothing, &Kind::Ce.into(), DType::F32);
    assert!(value[0] == 0.0 && gradient.iter().all(|g| *g == 0.0));
}

#[test]
fn blended_label_loss_has_the_same_bits_at_any_number_of_threads() {
    let (pixels, scores) = (pixels(60_000, 500), waves(2500, 0.77));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| {
            blended(
                true,
                &scores,
                &pixels,
                &Kind::Js { pi_rl: 0.9 }.into(),
                DType::F32,
            )
        })
    };
    assert_eq!(run(1), run(2));
}

/// Eq. 9 and its gradient; more samples than one task takes, some rows their own neighbours' neighbours.
fn divergence(fused: bool, dtype: DType) -> [Vec<f64>; 2] {
    let (points, width, k) = (1500, 6, 3);
    let features = tensor(
        waves(points * width, 0.83)
            .iter()
            .map(|v| 2.0 * v)
            .collect(),
        [points, width],
        dtype,
    );
    let chosen = (0..1400).map(|i| i * 7 % 1500).collect();
    let table: Vec<u32> = (0..(points * k) as u32)
        .map(|i| (i / 3 + 1 + i % 3 * 5) % 1500)
        .collect();
    let pairs = NeighbourPairs::new(chosen, &table, k);
    let value = match fused {
        true => neighbour_divergence(features.clone(), pairs),
        false => neighbour_divergence_plain(features.clone(), &pairs),
    };
    let gradients = (value.clone() * 2.0).backward();
    [
        host(value),
        host(features.grad(&gradients).expect("tracked")),
    ]
}

#[test]
fn neighbour_divergence_equals_its_plain_form_at_any_number_of_threads() {
    let [got, want] = [true, false].map(|fused| divergence(fused, DType::F64));
    assert!(want[0][0] > 0.1);
    assert_close(&got[0], &want[0], 1e-12, "divergence");
    assert_close(&got[1], &want[1], 1e-11, "its gradient");
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| divergence(true, DType::F32))
    };
    assert_eq!(run(1), run(2));
}
