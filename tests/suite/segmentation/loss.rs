//! Label losses and 3D regularisation: values by direct sums, gradients by finite differences, limits, hard cases.

use crate::support::label_losses::{
    KINDS, example, gradient_error, matrix, plain_device, scalar, waves,
};
use burn::tensor::{Device, Tensor, TensorData};
use coseg::config::{self, SegmentationConfig};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss, NeighbourPairs, neighbour_divergence};
use coseg::segmentation::neighbours::{PointIndex, without_self};
use coseg::segmentation::pixels::NO_CLASS;

/// The mean loss over the labelled rows of `logits`.
fn label_loss(logits: Tensor<2>, labels: &[u16], kind: &LabelLoss) -> Tensor<1> {
    CoSegLoss::from(*kind).of_logits(logits, labels)
}

/// Eq. 8 as it is written: two divergences, term by term, 0 ln 0 = 0.
fn direct(logits: &[f64], label: usize, kind: LabelLoss) -> f64 {
    let highest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = logits.iter().map(|z| (z - highest).exp()).sum();
    let p: Vec<f64> = logits.iter().map(|z| (z - highest).exp() / total).collect();
    match kind {
        LabelLoss::Ce => -p[label].ln(),
        LabelLoss::Gce { q } => (1.0 - p[label].powf(q)) / q,
        LabelLoss::Js { pi: pi_rl } => {
            let kappa = |k: usize| f64::from(u8::from(k == label));
            let m = |k: usize| pi_rl * kappa(k) + (1.0 - pi_rl) * p[k];
            let term = |a: f64, b: f64| if a > 0.0 { a * (a / b).ln() } else { 0.0 };
            let to_label: f64 = (0..p.len()).map(|k| term(kappa(k), m(k))).sum();
            let to_prediction: f64 = (0..p.len()).map(|k| term(p[k], m(k))).sum();
            (pi_rl * to_label + (1.0 - pi_rl) * to_prediction)
                / (-(1.0 - pi_rl) * (1.0 - pi_rl).ln())
        }
    }
}

#[test]
fn label_loss_equals_its_direct_sum() {
    let (logits, labels) = example();
    let device = plain_device();
    for kind in KINDS {
        let kept: Vec<usize> = (0..12).filter(|&i| labels[i] != NO_CLASS).collect();
        let sum: f64 = kept
            .iter()
            .map(|&i| direct(&logits[i * 5..][..5], labels[i].into(), kind))
            .sum();
        let want = sum / kept.len() as f64;
        let found = scalar(label_loss(matrix(&logits, 5, &device), &labels, &kind));
        assert!(
            (found - want).abs() < 1e-12 * want.max(1.0),
            "{kind:?}: {found} against {want}"
        );
    }
}

/// The loss of one pixel whose label has this log-probability, and p_y dL/dp_y.
fn of_log_probability(kind: LabelLoss, log_p: f64) -> (f64, f64) {
    let odds = -(-log_p).exp_m1().ln(); // logit of p
    let x = matrix(&[odds, 0.0], 2, &plain_device().autodiff()).require_grad();
    let loss = label_loss(x.clone(), &[0], &kind);
    let gradient = x.grad(&loss.backward()).expect("tracked");
    let gradient: Vec<f64> = gradient.into_data().into_vec().expect("f64");
    // dL/dz_y = p dL/dp (1 - p)
    (scalar(loss.inner()), gradient[0] / -log_p.exp_m1())
}

#[test]
fn label_loss_gradient_equals_finite_differences() {
    let (logits, labels) = example();
    let device = plain_device().autodiff();
    for kind in KINDS {
        let x = matrix(&logits, 5, &device).require_grad();
        let loss = label_loss(x.clone(), &labels, &kind) * 3.0;
        let gradient = x.grad(&loss.backward()).expect("tracked");
        let gradient: Vec<f64> = gradient.into_data().into_vec().expect("f64");
        let value = |x: &[f64]| 3.0 * scalar(label_loss(matrix(x, 5, &device), &labels, &kind));
        let error = gradient_error(&logits, &gradient, value);
        assert!(error < 1e-6, "{kind:?}: {error}");
        let corrupted: Vec<f64> = gradient.iter().map(|g| g * 1.01).collect();
        assert!(
            gradient_error(&logits, &corrupted, value) > 1e-3,
            "a wrong gradient must be caught"
        );
        assert!(
            gradient[3 * 5..4 * 5].iter().all(|&g| g == 0.0),
            "ignored pixels have no gradient"
        );
    }
}

#[test]
fn jensen_shannon_tends_to_cross_entropy_and_to_absolute_error() {
    for log_p in [-30.0, -4.0, -0.5, -1e-3, -1e-12] {
        let close = |a: (f64, f64), b: (f64, f64), tolerance: f64| {
            (a.0 - b.0).abs() <= tolerance * b.0.abs().max(1e-9)
                && (a.1 - b.1).abs() <= tolerance * b.1.abs()
        };
        // to first order in pi / p, and in 1 / ln(1 - pi)
        let js = of_log_probability(LabelLoss::Js { pi: 1e-22 }, log_p);
        assert!(
            close(js, of_log_probability(LabelLoss::Ce, log_p), 1e-6),
            "ln p {log_p}: {js:?}"
        );
        let js = of_log_probability(LabelLoss::Js { pi: 1.0 - 1e-16 }, log_p);
        let mae = of_log_probability(LabelLoss::Gce { q: 1.0 }, log_p);
        assert!(
            (js.0 - mae.0).abs() < 0.05 && (js.1 - mae.1).abs() <= 0.9 * -mae.1.min(-1e-300),
            "{log_p}: {js:?} {mae:?}"
        );
    }
}

/// The loss of f32 logits `[rows, columns]`, then its gradient by each.
fn in_f32(
    kind: &LabelLoss,
    logits: &[f32],
    columns: usize,
    labels: &[u16],
    device: &Device,
) -> Vec<f32> {
    let data = TensorData::new(logits.to_vec(), [logits.len() / columns, columns]);
    let x = Tensor::<2>::from_data(data, device).require_grad();
    let loss = label_loss(x.clone(), labels, kind);
    let gradients = loss.clone().backward();
    let gradient = x.grad(&gradients).expect("tracked").into_data();
    let mut numbers = vec![loss.into_scalar::<f32>()];
    numbers.extend(gradient.into_vec::<f32>().expect("f32"));
    numbers
}

#[test]
fn hard_logits_stay_finite() {
    let hard = [
        [1e4f32, -1e4, 0.0, -1e4, 1e4, 0.0],
        [1e4, 1e4, 1e4, -1e4, -1e4, -1e4],
        [0.0; 6],
    ];
    for (name, device) in crate::support::devices() {
        let device = device.autodiff();
        for kind in KINDS {
            for logits in hard {
                // Both rows have the second class, and no row the others.
                let numbers = in_f32(&kind, &logits, 3, &[1, 1], &device);
                let finite = numbers.iter().all(|v| v.is_finite());
                assert!(
                    finite && numbers[0] >= 0.0,
                    "{name}, {kind:?}, {logits:?}: {numbers:?}"
                );
            }
        }
    }
}

#[test]
fn nothing_labelled_and_one_class_cost_nothing_on_any_backend() {
    for (name, device) in crate::support::devices() {
        let device = device.autodiff();
        let logits: Vec<f32> = (0..12).map(|i| (i as f32).sin() * 3.0).collect();
        for kind in KINDS {
            for (columns, labels) in [(3, vec![NO_CLASS; 4]), (1, vec![0; 12])] {
                let numbers = in_f32(&kind, &logits, columns, &labels, &device);
                let none = numbers.iter().all(|v| v.abs() < 1e-6);
                assert!(none, "{name}, {kind:?}, {columns} classes: {numbers:?}");
            }
        }
    }
}

#[test]
fn nothing_labelled_costs_nothing_and_one_class_is_certain() {
    let device = plain_device().autodiff();
    for kind in KINDS {
        for (columns, labels) in [(3, vec![NO_CLASS; 4]), (1, vec![0; 12])] {
            let x = matrix(&waves(12, 3.0), columns, &device).require_grad();
            let loss = label_loss(x.clone(), &labels, &kind);
            let gradients = loss.clone().backward();
            assert!(scalar(loss).abs() < 1e-15, "{kind:?}");
            let g: Vec<f64> = x
                .grad(&gradients)
                .expect("tracked")
                .into_data()
                .into_vec()
                .expect("f64");
            assert!(g.iter().all(|g| g.abs() < 1e-15), "{kind:?} {g:?}");
        }
    }
}

#[test]
fn regularisation_equals_its_direct_sum_and_its_gradient_finite_differences() {
    let (points, width, k) = (9, 4, 5);
    let features = waves(points * width, 1.5);
    let positions: Vec<[f32; 3]> = (0..points)
        .map(|i| [(i as f32 * 2.3).sin(), (i as f32).cos(), 0.1 * i as f32])
        .collect();
    let neighbours = without_self(&positions, k).expect("finite");
    let chosen = [0u32, 3, 4, 8];
    let log_softmax = |x: &[f64], i: u32| -> Vec<f64> {
        let row = &x[i as usize * width..][..width];
        let total: f64 = row.iter().map(|z| z.exp()).sum();
        row.iter().map(|z| z - total.ln()).collect()
    };
    let value = |x: &[f64]| {
        let mut sum = 0.0;
        for &j in &chosen {
            for &n in &neighbours[j as usize * k..][..k] {
                assert_ne!(n, j);
                let (a, b) = (log_softmax(x, j), log_softmax(x, n));
                sum += (0..width).map(|c| a[c].exp() * (a[c] - b[c])).sum::<f64>();
            }
        }
        sum / (chosen.len() * k) as f64
    };
    let device = plain_device().autodiff();
    let x = matrix(&features, width, &device).require_grad();
    let pairs = NeighbourPairs::new(chosen.to_vec(), &neighbours, k);
    let loss = neighbour_divergence(x.clone(), &pairs);
    let gradients = loss.clone().backward();
    assert!((scalar(loss) - value(&features)).abs() < 1e-12);
    let g: Vec<f64> = x
        .grad(&gradients)
        .expect("tracked")
        .into_data()
        .into_vec()
        .expect("f64");
    let error = gradient_error(&features, &g, value);
    assert!(error < 1e-6, "{error}");
    let none = neighbour_divergence(
        matrix(&features, width, &device),
        &NeighbourPairs::new(Vec::new(), &neighbours, k),
    );
    assert_eq!(scalar(none), 0.0);
}

#[test]
fn neighbours_without_self_repeat_in_small_sets() {
    let line = |count: usize| (0..count).map(|i| [i as f32, 0.0, 0.0]).collect::<Vec<_>>();
    assert_eq!(
        without_self(&line(3), 5).expect("finite"),
        [1, 2, 1, 2, 1, 0, 2, 0, 2, 0, 1, 0, 1, 0, 1]
    );
    assert_eq!(without_self(&line(1), 2).expect("finite"), [0, 0]);
    assert!(without_self(&[], 5).expect("nothing to do").is_empty());
    let points: Vec<[f32; 3]> = (0..300)
        .map(|i| std::array::from_fn(|a| ((i * 7 + a * 13) as f32).sin()))
        .collect();
    let own = PointIndex::new(&points).expect("finite").neighbours(16);
    let others: Vec<u32> = (0..300).flat_map(|i| own.row(i)[1..6].to_vec()).collect();
    assert_eq!(without_self(&points, 5).expect("finite"), others);
}

/// To first order the loss is what the labelled class lacks, whatever the weight: digits that a difference of logarithms near
/// ln 1 would lose.
#[test]
fn js_of_a_nearly_right_prediction_is_what_it_lacks() {
    for pi_rl in [0.01, 0.1, 0.5, 0.9, 0.99] {
        for height in [20.0_f64, 25.0, 30.0] {
            let lacks = (-height).exp() / (1.0 + (-height).exp());
            let logits = matrix(&[height, 0.0], 2, &plain_device());
            let loss = scalar(label_loss(logits, &[0], &LabelLoss::Js { pi: pi_rl }));
            assert!(
                (loss / lacks - 1.0).abs() < 1e-7,
                "{pi_rl}, {height}: {loss:e} for {lacks:e}"
            );
        }
    }
}

#[test]
fn settings_choose_the_loss() {
    let of = |config: SegmentationConfig| LabelLoss::from_config(&config);
    let gce = |exponent| SegmentationConfig {
        loss: Some(config::LabelLoss::Gce {
            exponent,
            least_recall: 0.3,
        }),
        ..Default::default()
    };
    assert_eq!(of(gce(0.4)).unwrap(), LabelLoss::Gce { q: 0.4 });
    let js = |pi_rl| SegmentationConfig {
        loss: Some(config::LabelLoss::Js { pi_rl }),
        ..Default::default()
    };
    assert_eq!(of(js(0.3)).unwrap(), LabelLoss::Js { pi: 0.3 });
    for q in [0.0, 1e-9, 1.1, f64::NAN] {
        crate::support::assert_names(
            &of(gce(q)).unwrap_err(),
            &["segmentation.loss.gce.exponent", "from 0.000001 to 1"],
        );
    }
    crate::support::assert_names(&of(js(1.0)).unwrap_err(), &["segmentation.loss.js.pi_rl"]);
}
