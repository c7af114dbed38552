//! Label losses against distributions over classes: values by direct sums, gradients by finite differences, hard cases.

use crate::support::label_losses::{
    KINDS, example, gradient_error, matrix, plain_device, scalar, waves,
};
use burn::tensor::{DType, Device};
use coseg::ops::SparseMatrix;
use coseg::segmentation::loss::{CoSegLoss, LabelLoss, Scores};
use coseg::segmentation::pixels::{LabelledPixels, PixelWeights};
use std::sync::Arc;

/// Class probabilities of 12 pixels and 5 classes; the first four name one class alone.
fn distributions() -> Vec<f64> {
    let mut rows: Vec<f64> = waves(60, 1.5).iter().map(|z| (2.0 * z).exp()).collect();
    for (pixel, row) in rows.chunks_exact_mut(5).enumerate() {
        if pixel < 4 {
            (0..5).for_each(|k| row[k] = f64::from(u8::from(k == pixel)));
        }
        let total: f64 = row.iter().sum();
        row.iter_mut().for_each(|y| *y /= total);
    }
    rows
}

/// The losses between probabilities and a label that is a distribution, term by term.
fn direct_of_distribution(logits: &[f64], y: &[f64], kind: LabelLoss) -> f64 {
    let total: f64 = logits.iter().map(|z| z.exp()).sum();
    let p: Vec<f64> = logits.iter().map(|z| z.exp() / total).collect();
    let sum = |term: &dyn Fn(f64, f64) -> f64| p.iter().zip(y).map(|(&p, &y)| term(p, y)).sum();
    match kind {
        LabelLoss::Ce => sum(&|p, y| -y * p.ln()),
        LabelLoss::Gce { q } => sum(&|p, y| y * (1.0 - p.powf(q)) / q),
        LabelLoss::Js { pi } => {
            let term = |a: f64, m: f64| if a > 0.0 { a * (a / m).ln() } else { 0.0 };
            let m = |p: f64, y: f64| pi * y + (1.0 - pi) * p;
            let to_label: f64 = sum(&|p, y| term(y, m(p, y)));
            let to_prediction: f64 = sum(&|p, y| term(p, m(p, y)));
            (pi * to_label + (1.0 - pi) * to_prediction) / (-(1.0 - pi) * (1.0 - pi).ln())
        }
    }
}

/// `pixels` with weights of 1 on a Gaussian each, and distributions.
fn pixels_with(y: &[f64], device: &Device) -> LabelledPixels {
    let weights = SparseMatrix::selection((0..12).collect(), 12);
    LabelledPixels {
        distributions: Some(matrix(y, 5, device)),
        ..LabelledPixels::new(PixelWeights::Stored(Arc::new(weights)), vec![0; 12])
    }
}

#[test]
fn losses_of_distributions_equal_their_direct_sums() {
    let (logits, _) = example();
    let y = distributions();
    let device = plain_device();
    let autodiff = device.clone().autodiff();
    for kind in KINDS {
        let of_row =
            |i: usize| direct_of_distribution(&logits[5 * i..][..5], &y[5 * i..][..5], kind);
        let want = (0..12).map(of_row).sum::<f64>() / 12.0;
        let loss = |values: &[f64], device: &Device| {
            let scores = Scores::Pixels(matrix(values, 5, device));
            let pixels = pixels_with(&y, &plain_device());
            CoSegLoss::from(kind)
                .forward(scores, &pixels, None)
                .expect("a loss")
        };
        let found = scalar(loss(&logits, &device));
        assert!(
            (found - want).abs() < 1e-6 * want.max(1.0),
            "{kind:?}: {found} against {want}"
        );
        let x = matrix(&logits, 5, &autodiff).require_grad();
        let scores = Scores::Pixels(x.clone());
        let graph = CoSegLoss::from(kind)
            .forward(scores, &pixels_with(&y, &device), None)
            .expect("a loss");
        let gradient = x.grad(&graph.backward()).expect("tracked");
        let gradient: Vec<f64> = gradient.into_data().into_vec().expect("f64");
        let error = gradient_error(&logits, &gradient, |values| scalar(loss(values, &device)));
        assert!(error < 1e-6, "{kind:?}: {error}");
    }
}

#[test]
fn a_distribution_on_one_class_is_its_label() {
    let (logits, _) = example();
    let labels: Vec<u16> = (0..12).map(|i| i * 7 % 5).collect();
    let y: Vec<f64> = labels
        .iter()
        .flat_map(|&label| (0..5).map(move |k| f64::from(u8::from(k == label))))
        .collect();
    let device = plain_device();
    for kind in KINDS {
        for robustness in [vec![], vec![0.2, 1.0, 0.0, 0.5]] {
            let loss = CoSegLoss {
                robustness,
                ..CoSegLoss::from(kind)
            };
            let hard = scalar(loss.of_logits(matrix(&logits, 5, &device), &labels));
            let scores = Scores::Pixels(matrix(&logits, 5, &device));
            let soft = loss.forward(scores, &pixels_with(&y, &device), None);
            let soft = scalar(soft.expect("a loss"));
            assert!(
                (soft - hard).abs() < 1e-6 * hard.max(1.0),
                "{kind:?}: {soft}, {hard}"
            );
        }
    }
}

#[test]
fn distributions_and_certain_logits_stay_finite() {
    let device = plain_device().autodiff();
    // Class 0 is certain, and the label lacks classes 1 to 3.
    let logits: Vec<f64> = [[300.0, -300.0, 0.0, 1.0, 2.0]; 12].concat();
    let y: Vec<f64> = [[0.0, 0.0, 0.0, 0.0, 1.0]; 12].concat();
    for kind in KINDS {
        let x = matrix(&logits, 5, &device).cast(DType::F32).require_grad();
        let pixels = pixels_with(&y, &plain_device());
        let pixels = LabelledPixels {
            distributions: pixels.distributions.map(|y| y.cast(DType::F32)),
            ..pixels
        };
        let scores = Scores::Pixels(x.clone());
        let loss = CoSegLoss::from(kind).forward(scores, &pixels, None);
        let loss = loss.expect("a loss");
        let gradient = x.grad(&loss.backward()).expect("tracked");
        let gradient: Vec<f32> = gradient.into_data().into_vec().expect("f32");
        assert!(loss.into_scalar::<f32>().is_finite(), "{kind:?}");
        assert!(gradient.iter().all(|g| g.is_finite()), "{kind:?}");
    }
}
