//! The generalised Jensen-Shannon loss against its definition; dropout of channels.

use crate::support::joined_pyramid;
use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::config::{SpatialConfig, SpatialSource};
use coseg::pipeline::train_decoder::dropped_channels;
use coseg::segmentation::decoder::DecoderConfig;
use coseg::segmentation::encoder::{Cloud, encode, load_spatial};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss};
use coseg::segmentation::pixels::NO_CLASS;
use coseg::segmentation::pyramid::{Pyramid, Switches};
use glam::DVec3;

const CLASSES: usize = 4;

/// Two predictions of five pixels, and their labels.
fn example() -> ([Vec<f64>; 2], Vec<u16>) {
    let rows = |phase: f64| -> Vec<f64> {
        let powers: Vec<f64> = (0..5 * CLASSES)
            .map(|i| (1.5 * (i as f64 * 1.3 + phase).sin()).exp())
            .collect();
        powers
            .chunks_exact(CLASSES)
            .flat_map(|p| {
                p.iter()
                    .map(|x| x / p.iter().sum::<f64>())
                    .collect::<Vec<_>>()
            })
            .collect()
    };
    ([rows(0.2), rows(2.9)], vec![0, 3, 1, 2, 2])
}

fn tensor(values: &[f64], device: &Device) -> Tensor<2> {
    Tensor::from_data(
        TensorData::new(values.to_vec(), [values.len() / CLASSES, CLASSES]),
        (device, DType::F64),
    )
}

fn entropy(p: &[f64]) -> f64 {
    -p.iter()
        .filter(|p| **p > 0.0)
        .map(|p| p * p.ln())
        .sum::<f64>()
}

/// JS of the label and two predictions with weights pi, (1 - pi) / 2, (1 - pi) / 2, over Z.
fn direct([a, b]: [&[f64]; 2], label: usize, pi: f64) -> f64 {
    let rest = 0.5 * (1.0 - pi);
    let mean: Vec<f64> = (0..CLASSES)
        .map(|k| f64::from(u8::from(k == label)) * pi + rest * (a[k] + b[k]))
        .collect();
    (entropy(&mean) - rest * (entropy(a) + entropy(b))) / (-(1.0 - pi) * (1.0 - pi).ln())
}

fn generalised_js(pi: f64) -> CoSegLoss {
    CoSegLoss::from(LabelLoss::Gjs { pi })
}

fn loss(pair: &[Vec<f64>; 2], labels: &[u16], pi: f64, device: &Device) -> f64 {
    let pair = pair.each_ref().map(|p| tensor(p, device));
    generalised_js(pi)
        .of_pair(pair, labels)
        .into_scalar::<f64>()
}

#[test]
fn generalised_js_equals_its_definition() {
    let (pair, labels) = example();
    let device = crate::support::device();
    for pi in [0.1, 0.5, 0.9, 0.99] {
        let of = |i: usize| pair.each_ref().map(|p| &p[i * CLASSES..][..CLASSES]);
        let want = labels
            .iter()
            .enumerate()
            .map(|(i, &l)| direct(of(i), l.into(), pi))
            .sum::<f64>()
            / 5.0;
        let found = loss(&pair, &labels, pi, &device);
        // the floor of 1e-8 under every probability
        assert!(
            (found - want).abs() < 1e-6 * want,
            "pi {pi}: {found} against {want}"
        );
    }
}

#[test]
fn two_predictions_that_agree_leave_the_label_term() {
    let ([a, _], labels) = example();
    let device = crate::support::device();
    let at = |loss: CoSegLoss| {
        loss.of_pair([tensor(&a, &device), tensor(&a, &device)], &labels)
            .into_scalar::<f64>()
    };
    let label_term = at(LabelLoss::Js { pi: 0.9 }.into());
    let both = at(generalised_js(0.9));
    assert!(
        (both - label_term).abs() < 1e-12 * label_term,
        "{both} {label_term}"
    );
    let none = generalised_js(0.9).of_pair([tensor(&[], &device), tensor(&[], &device)], &[]);
    assert_eq!(none.into_scalar::<f64>(), 0.0);
    let unlabelled =
        generalised_js(0.9).of_pair([tensor(&a, &device), tensor(&a, &device)], &[NO_CLASS; 5]);
    assert!(unlabelled.into_scalar::<f64>().abs() < 1e-12);
}

#[test]
fn its_gradient_is_finite_at_certain_predictions_and_right_elsewhere() {
    let (pair, labels) = example();
    let device = crate::support::device().autodiff();
    let gradient = |pair: &[Vec<f64>; 2]| -> Vec<f64> {
        let a = tensor(&pair[0], &device).require_grad();
        let value = generalised_js(0.9).of_pair([a.clone(), tensor(&pair[1], &device)], &labels);
        a.grad(&value.backward())
            .expect("tracked")
            .into_data()
            .into_vec()
            .expect("f64")
    };
    let found = gradient(&pair);
    let plain = crate::support::device();
    for i in 0..found.len() {
        let at = |delta: f64| {
            let mut pair = pair.clone();
            pair[0][i] += delta;
            loss(&pair, &labels, 0.9, &plain)
        };
        let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
        assert!(
            (found[i] - numeric).abs() < 1e-6,
            "{i}: {} against {numeric}",
            found[i]
        );
    }
    let mut certain = pair;
    for p in &mut certain {
        p[..CLASSES].copy_from_slice(&[0.0, 0.0, 1.0, 0.0]);
    }
    assert!(gradient(&certain).iter().all(|g| g.is_finite()));
}

#[test]
fn dropout_is_a_scaling_of_the_frozen_channels() {
    let device = crate::support::device();
    let positions: Vec<[f32; 3]> = (0..700)
        .map(|i| std::array::from_fn(|a| (i as f32 * [0.37, 0.61, 0.83][a]).sin()))
        .collect();
    let config = SpatialConfig {
        source: SpatialSource::Random,
        ..SpatialConfig::default()
    };
    let (encoder, _) = load_spatial(&config, 5, &device).expect("random weights");
    let cloud = Cloud {
        positions: &positions,
        colors: None,
        up: DVec3::Y,
        scale: 1.0,
    };
    let encoding = encode(&encoder, &cloud, 3, &device).expect("finite");
    let pyramid = joined_pyramid(
        &encoding,
        &[],
        Switches {
            image: false,
            ..Switches::default()
        },
    );

    let factors = dropped_channels(&pyramid, 0.25, 3, 7);
    assert_eq!(factors, dropped_channels(&pyramid, 0.25, 3, 7));
    assert_ne!(factors, dropped_channels(&pyramid, 0.25, 3, 8));
    assert_ne!(factors, dropped_channels(&pyramid, 0.25, 4, 7));
    let all: Vec<f32> = factors.concat();
    assert!(all.iter().all(|&f| f == 0.0 || f == 1.0 / 0.75));
    let share = all.iter().filter(|f| **f == 0.0).count() as f64 / all.len() as f64;
    assert!(
        (share - 0.25).abs() < 4.0 * (0.25 * 0.75 / all.len() as f64).sqrt(),
        "{share} of {}",
        all.len()
    );

    let decoder = DecoderConfig::for_pyramid(&pyramid, CLASSES).init(&device);
    let mut scaled = pyramid.clone();
    for (level, factors) in scaled.levels.iter_mut().zip(&factors) {
        let factors = TensorData::new(factors.clone(), [1, factors.len()]);
        level.features = level.features.clone() * Tensor::<2>::from_data(factors, &device);
    }
    let values = |pyramid: &Pyramid| -> Vec<f32> {
        let hidden = decoder.forward(pyramid).hidden;
        hidden.into_data().into_vec().expect("f32")
    };
    let (found, want) = (values(&pyramid.scaled(&factors)), values(&scaled));
    let largest = want.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let difference = found
        .iter()
        .zip(&want)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(difference < 1e-5 * largest, "{difference} of {largest}");
    let plain = values(&pyramid);
    assert!(
        plain
            .iter()
            .zip(&found)
            .any(|(a, b)| (a - b).abs() > 0.01 * largest),
        "nothing was dropped"
    );
}
