//! Products of tall matrices with small ones on a GPU, against the CPU's kernels in f64, fed the same f32 numbers.

use crate::backend::device_training::on_device;
use crate::ops::device_ops::{assert_close, leaf, uneven, value_and_gradients, waves};
use burn::tensor::{Device, Tensor};
use coseg::ops::{LayerMap, dense, fusion_layer};
use std::sync::Arc;

/// Rows, inputs, width.
const SIZES: [[usize; 3]; 12] = [
    [1, 1, 1],
    [1, 400, 101],
    [255, 6, 3],
    [256, 64, 64],
    [257, 65, 101],
    [1000, 400, 64],
    [513, 16, 17],
    [300, 0, 5],
    [300, 64, 16],
    [64, 128, 256],
    [40_000, 3, 1],
    [70_000, 64, 20],
];

/// `waves` without its period: long sums neither vanish nor repeat.
fn numbers(count: usize, amplitude: f32) -> Vec<f32> {
    let own = waves(count, 0.6);
    own.iter()
        .enumerate()
        .map(|(i, v)| amplitude * (v + 0.5 * ((i * i % 1009) as f32 / 1009.0) - 0.2))
        .collect()
}

#[test]
fn dense_maps_with_and_without_a_bias() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    for [rows, inputs, width] in SIZES {
        if inputs == 0 {
            continue;
        }
        let (x, weight, bias) = (
            numbers(rows * inputs, 1.0),
            numbers(inputs * width, 0.5),
            numbers(width, 0.3),
        );
        for with_bias in [true, false] {
            let given = [(&x[..], inputs), (&weight[..], width), (&bias[..], width)];
            let given = if with_bias { &given[..] } else { &given[..2] };
            let run = |on: Option<&Device>| {
                value_and_gradients(given, on, |t| {
                    dense(
                        t[0].clone(),
                        t[1].clone(),
                        t.get(2).map(|bias| bias.clone().reshape([width])),
                    )
                })
            };
            let got = on_device(Some(&gpu), || run(Some(&gpu)));
            for ((got, want), name) in got
                .iter()
                .zip(&run(None))
                .zip(["value", "x", "weight", "bias"])
            {
                assert_close(
                    got,
                    want,
                    1e-5,
                    &format!("{name}: {rows} x {inputs} x {width}, bias {with_bias}"),
                );
            }
            assert_eq!(got, run(Some(&gpu)), "the same bits each time");
        }
    }
}

#[test]
fn a_dense_map_of_no_rows_and_of_frozen_ones() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let weight = leaf(&waves(15, 1.0), 5, Some(&gpu));
    let none = Tensor::zeros([0, 3], &gpu).require_grad();
    let out = dense(none, weight.clone(), None);
    assert_eq!(out.dims(), [0, 5]);
    let gradients = out.sum().backward();
    assert_eq!(
        crate::ops::device_ops::host(weight.grad(&gradients).expect("tracked")),
        [0.0; 15]
    );
    let frozen = Tensor::from_inner(leaf(&waves(12, 1.0), 3, Some(&gpu)).inner());
    let gradients = dense(frozen.clone(), weight.clone(), None).sum().backward();
    assert!(frozen.grad(&gradients).is_none() && weight.grad(&gradients).is_some());
    // Nothing is tracked.
    assert_eq!(
        dense(frozen.clone().inner(), weight.inner(), None).dims(),
        [4, 5]
    );
}

#[test]
fn layers_of_the_decoder_of_all_sizes() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    for [rows, inputs, width] in SIZES {
        // All rows in order, or some of more in another one; none twice, for 7919 is prime.
        let total = rows + rows / 3 + 1;
        assert_ne!(total % 7919, 0);
        let some: Vec<u32> = (0..rows).map(|r| ((r * 7919 + 5) % total) as u32).collect();
        for some in [None, Some(some)] {
            let all = if some.is_some() { total } else { rows };
            let map = LayerMap {
                rows: some.map(|rows| Arc::new(rows.into())),
                upsample: Arc::new(uneven(rows, 9)),
                slope: 0.2,
            };
            let (x, weight) = (numbers(all * inputs, 1.0), numbers(inputs * width, 0.5));
            let (below, bias) = (numbers(9 * width, 0.7), numbers(width, 0.3));
            let run = |on: Option<&Device>| {
                let given = [
                    (&below[..], width),
                    (&bias[..], width),
                    (&x[..], inputs),
                    (&weight[..], width),
                ];
                value_and_gradients(if inputs > 0 { &given } else { &given[..2] }, on, |t| {
                    let empty =
                        |shape: [usize; 2]| Tensor::zeros(shape, (&t[0].device(), t[0].dtype()));
                    let [x, weight] = if inputs > 0 {
                        [t[2].clone(), t[3].clone()]
                    } else {
                        [empty([all, 0]), empty([0, width])]
                    };
                    fusion_layer(
                        x,
                        weight,
                        t[0].clone(),
                        t[1].clone().reshape([width]),
                        map.clone(),
                    )
                })
            };
            let what = format!("{rows} x {inputs} x {width}, of {all}");
            let got = on_device(Some(&gpu), || run(Some(&gpu)));
            for ((got, want), name) in got
                .iter()
                .zip(&run(None))
                .zip(["value", "below", "bias", "x", "weight"])
            {
                assert_close(got, want, 1e-5, &format!("{name}: {what}"));
            }
        }
    }
}
