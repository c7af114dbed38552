//! Logits, labels and finite differences for tests of label losses.

use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::segmentation::loss::LabelLoss;
use coseg::segmentation::pixels::NO_CLASS;

/// Every label loss.
pub const KINDS: [LabelLoss; 8] = [
    LabelLoss::Ce,
    LabelLoss::Gce { q: 0.7 },
    LabelLoss::Gce { q: 0.01 },
    LabelLoss::Gce { q: 1.0 },
    LabelLoss::Js { pi: 0.1 },
    LabelLoss::Js { pi: 0.5 },
    LabelLoss::Js { pi: 0.9 },
    LabelLoss::Js { pi: 0.97 },
];

/// A device without autodiff.
pub fn plain_device() -> Device {
    crate::support::device()
}

/// `values` in f64, row by row.
pub fn matrix(values: &[f64], columns: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(
        TensorData::new(values.to_vec(), [values.len() / columns, columns]),
        (device, DType::F64),
    )
}

/// The number in a tensor of one.
pub fn scalar(t: Tensor<1>) -> f64 {
    t.into_scalar::<f64>()
}

/// Numbers up to twice `amplitude`, of both signs.
pub fn waves(count: usize, amplitude: f64) -> Vec<f64> {
    (0..count)
        .map(|i| amplitude * (i as f64 * 1.7 + 0.3).sin() * (1.0 + (i as f64 * 0.31).cos()))
        .collect()
}

/// Logits, labels (every fourth ignored) of 12 pixels and 5 classes.
pub fn example() -> (Vec<f64>, Vec<u16>) {
    (
        waves(60, 2.0),
        (0..12)
            .map(|i| if i % 4 == 3 { NO_CLASS } else { i * 7 % 5 })
            .collect(),
    )
}

/// Largest |analytic - numeric| relative to max(|analytic|, rms of the gradient).
pub fn gradient_error(x: &[f64], analytic: &[f64], value: impl Fn(&[f64]) -> f64) -> f64 {
    assert!(analytic.iter().all(|g| g.is_finite()));
    let rms = (analytic.iter().map(|g| g * g).sum::<f64>() / analytic.len() as f64).sqrt();
    let mut worst: f64 = 0.0;
    for i in 0..x.len() {
        let at = |delta: f64| {
            let mut x = x.to_vec();
            x[i] += delta;
            value(&x)
        };
        let h = 1e-3; // fourth-order central differences
        let numeric = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
        assert!(numeric.is_finite());
        worst = worst.max((analytic[i] - numeric).abs() / analytic[i].abs().max(rms));
    }
    worst
}
