//! Operations with GPU kernels against the CPU's in f64, fed the same f32 numbers.

use crate::support::device_tensors::{assert_close, host, leaf, value_and_gradients, waves};
use burn::tensor::Device;
use coseg::ops::{SparseMatrix, sparse_apply};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss, Scores};
use coseg::segmentation::pixels::{LabelledPixels, NO_CLASS, PixelWeights};
use std::sync::Arc;

/// The wgpu device with autodiff, if this machine has one.
fn gpu() -> Option<Device> {
    crate::support::gpu().map(Device::autodiff)
}

/// Rows of very different lengths, some empty, and an unused column.
pub fn uneven(rows: usize, columns: usize) -> SparseMatrix {
    let length = |r: usize| {
        if r % 5 == 3 {
            0
        } else {
            1 + r * 7 % (columns - 1)
        }
    };
    let mut offsets = vec![0];
    let (mut indices, mut values) = (Vec::new(), Vec::new());
    for r in 0..rows {
        indices.extend((0..length(r)).map(|k| ((r * 3 + k * 2) % (columns - 1)) as u32));
        values.extend((0..length(r)).map(|k| ((r + 2 * k) as f32 * 0.7).sin()));
        offsets.push(indices.len() as u32);
    }
    SparseMatrix::new(columns, offsets, indices, values)
}

#[test]
fn sparse_products() {
    let Some(device) = gpu() else { return };
    for (rows, columns, channels) in [
        (1, 2, 1),
        (7, 4, 3),
        (300, 90, 5),
        (40, 700, 64),
        (9, 5, 300),
    ] {
        let matrix = Arc::new(uneven(rows, columns));
        let x = waves(columns * channels, 1.3);
        let run = |gpu| {
            value_and_gradients(&[(&x, channels)], gpu, |l| {
                sparse_apply(l[0].clone(), matrix.clone())
            })
        };
        let (got, want) = (run(Some(&device)), run(None));
        for ((got, want), what) in got.iter().zip(&want).zip(["product", "gradient"]) {
            assert_close(
                got,
                want,
                1e-5,
                &format!("{rows}x{columns}, {channels} channels: {what}"),
            );
        }
        // The copy that the device keeps serves again, to the same bits.
        assert_eq!(got, run(Some(&device)));
    }
}

#[test]
fn a_sparse_product_of_nothing() {
    let Some(device) = gpu() else { return };
    let none = Arc::new(SparseMatrix::new(3, vec![0], Vec::new(), Vec::new()));
    let out = sparse_apply(leaf(&waves(6, 1.0), 2, Some(&device)), none);
    assert_eq!(out.dims(), [0, 2]);
    let empty_rows = Arc::new(SparseMatrix::new(3, vec![0, 0, 0], Vec::new(), Vec::new()));
    let out = sparse_apply(leaf(&waves(6, 1.0), 2, Some(&device)), empty_rows);
    assert_eq!(host(out.inner()), [0.0; 4]);
}

const KINDS: [LabelLoss; 8] = [
    LabelLoss::Ce,
    LabelLoss::Gce { q: 0.7 },
    LabelLoss::Gce { q: 0.01 },
    LabelLoss::Gce { q: 1.0 },
    LabelLoss::Js { pi: 0.01 },
    LabelLoss::Js { pi: 0.5 },
    LabelLoss::Js { pi: 0.9 },
    LabelLoss::Js { pi: 0.99 },
];

#[test]
fn label_losses() {
    let Some(device) = gpu() else { return };
    for (pixels, classes, amplitude) in [
        (1, 2, 1.0),
        (12, 5, 2.0),
        (700, 19, 0.1),
        (700, 19, 6.0),
        (300, 150, 3.0),
    ] {
        let logits = waves(pixels * classes, amplitude);
        let label = |i: usize| {
            if i % 4 == 3 {
                NO_CLASS
            } else {
                (i * 7 % classes) as u16
            }
        };
        let labels: Vec<u16> = (0..pixels).map(label).collect();
        for kind in KINDS {
            let run = |gpu| {
                value_and_gradients(&[(&logits, classes)], gpu, |l| {
                    CoSegLoss::from(kind)
                        .of_logits(l[0].clone(), &labels)
                        .unsqueeze()
                })
            };
            let (got, want) = (run(Some(&device)), run(None));
            for ((got, want), what) in got.iter().zip(&want).zip(["loss", "gradient"]) {
                assert_close(
                    got,
                    want,
                    2e-5,
                    &format!("{kind:?}, {pixels} pixels, {classes} classes: {what}"),
                );
            }
        }
    }
}

/// Predictions so sure, rightly and wrongly, that probabilities round to 0 and 1: the loss and its gradient stay finite, and
/// those of what is nearly right keep their digits.
#[test]
fn label_losses_of_sure_predictions() {
    let Some(device) = gpu() else { return };
    for height in [0.0, 5.0, 12.0, 30.0, 80.0, 200.0] {
        for label in [0, 1] {
            let logits = [height, 0.0, -0.5];
            for kind in KINDS {
                let run = |gpu| {
                    value_and_gradients(&[(&logits, 3)], gpu, |l| {
                        CoSegLoss::from(kind)
                            .of_logits(l[0].clone(), &[label])
                            .unsqueeze()
                    })
                };
                let (got, want) = (run(Some(&device)), run(None));
                assert!(
                    got.iter().flatten().all(|v| v.is_finite()),
                    "{kind:?}, {height}: {got:?}"
                );
                for ((got, want), what) in got.iter().zip(&want).zip(["loss", "gradient"]) {
                    // Below the smallest normal f32 nothing is left.
                    let want: Vec<f64> = want
                        .iter()
                        .map(|v| if v.abs() < 1e-37 { 0.0 } else { *v })
                        .collect();
                    assert_close(
                        got,
                        &want,
                        2e-5,
                        &format!("{kind:?}, height {height}, label {label}: {what}"),
                    );
                }
            }
        }
    }
}

#[test]
fn blended_label_losses() {
    let Some(device) = gpu() else { return };
    let (rows, points, classes) = (400, 60, 5);
    let indices = (0..rows * 4)
        .map(|i| ((i * 7 + i / 4 * 3) % points) as u32)
        .collect();
    let offsets = (0..=rows as u32).map(|r| 4 * r).collect();
    let weights = SparseMatrix::new(
        points,
        offsets,
        indices,
        [0.5, 0.25, 0.125, 0.125].repeat(rows),
    );
    let chosen: Vec<u32> = (0..rows as u32).filter(|r| r % 3 != 1).collect();
    let label = |&r: &u32| {
        if r % 11 == 5 {
            NO_CLASS
        } else {
            (r / 2 % 5) as u16
        }
    };
    let labels = chosen.iter().map(label).collect();
    let pixels = Arc::new(LabelledPixels::new(
        PixelWeights::Stored(Arc::new(weights.select_rows(&chosen))),
        labels,
    ));
    let scores = waves(points * classes, 2.5);
    let shares = vec![0.5, 1.0, 0.0, 0.9];
    let for_all = KINDS.into_iter().map(CoSegLoss::from);
    for kind in for_all.chain(KINDS.into_iter().map(|label| CoSegLoss {
        robustness: shares.clone(),
        ..label.into()
    })) {
        let run = |gpu| {
            value_and_gradients(&[(&scores, classes)], gpu, |l| {
                kind.forward(Scores::Gaussians(l[0].clone()), &pixels, None)
                    .expect("a loss")
                    .unsqueeze()
            })
        };
        let (got, want) = (run(Some(&device)), run(None));
        for ((got, want), what) in got.iter().zip(&want).zip(["loss", "gradient"]) {
            assert_close(got, want, 2e-5, &format!("{kind:?}: {what}"));
        }
    }
}
