//! What a step of training has besides rasterizing and losses, on a GPU: optimiser, running means, Eq. 9. Against the CPU's
//! kernels in f64, fed the same f32 numbers.

use crate::support::device_tensors::{assert_close, host, leaf, value_and_gradients, waves};
use crate::support::on_device;
use burn::tensor::Device;
use coseg::ops::{AdamStep, AdamTensors, adam_step, sum_all};
use coseg::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use std::sync::Arc;

#[test]
fn adam_steps_with_one_rate_and_with_one_a_column() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let plain = |values: &[f32], on: Option<&Device>| leaf(values, 5, on).inner();
    for rates in [
        vec![3e-3],
        (1..=5).map(|k| 1e-3 * f64::from(k)).collect::<Vec<_>>(),
    ] {
        let run = |on: Option<&Device>| {
            let start = plain(&waves(415, 1.0), on);
            let zero = start.zeros_like();
            let mut state = AdamTensors {
                param: start.clone(),
                first: zero.clone(),
                second: zero,
            };
            for step in 1..=8 {
                let gradient: Vec<f32> = waves(415, 0.1)
                    .iter()
                    .map(|v| v.powi(3) * step as f32)
                    .collect();
                state = adam_step(
                    state,
                    plain(&gradient, on),
                    &Arc::new(AdamStep {
                        rates: rates.clone(),
                        views: 2 * step,
                        batch: 2,
                    }),
                );
            }
            // Somebody else held it: the step wrote elsewhere.
            assert_close(
                &host(start),
                &host(plain(&waves(415, 1.0), on)),
                0.0,
                "what the step began with",
            );
            [state.param, state.first, state.second].map(host)
        };
        let names = ["param", "first moment", "second moment"];
        let got = on_device(Some(&gpu), || run(Some(&gpu)));
        for ((got, want), name) in got.iter().zip(&run(None)).zip(names) {
            assert_close(got, want, 1e-6, &format!("{name}, {} rates", rates.len()));
        }
    }
}

#[test]
fn divergences_of_neighbours() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    for (points, width, samples, k) in [
        (40, 5, 17, 3),
        (300, 128, 120, 6),
        (9, 300, 9, 8),
        (3, 1, 2, 1),
    ] {
        // Neighbours that are sampled too, rows that are a neighbour of many, and rows that are a neighbour of none.
        let neighbours = (0..samples * k)
            .map(|i| ((i * i + i / k) % points.min(points / 2 + 2)) as u32)
            .collect();
        let chosen: Vec<u32> = (0..samples as u32).rev().collect();
        let run = |on: Option<&Device>, chosen: &[u32]| {
            let pairs = NeighbourPairs {
                chosen: chosen.to_vec(),
                neighbours: Vec::clone(&neighbours),
            };
            value_and_gradients(&[(&waves(points * width, 2.5), width)], on, |t| {
                neighbour_divergence(t[0].clone(), &pairs).reshape([1, 1])
            })
        };
        let mut twice = chosen.clone();
        twice[0] = twice[1];
        on_device(Some(&gpu), || run(Some(&gpu), &chosen));
        for chosen in [chosen, twice] {
            for ((got, want), name) in run(Some(&gpu), &chosen)
                .iter()
                .zip(&run(None, &chosen))
                .zip(["value", "gradient"])
            {
                assert_close(
                    got,
                    want,
                    1e-5,
                    &format!("{name}: {points} points, {width} channels, {k} neighbours"),
                );
            }
        }
    }
}

#[test]
fn sums_of_all_values() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    for (rows, columns) in [
        (1, 1),
        (255, 1),
        (257, 1),
        (8192, 1),
        (8193, 1),
        (70_000, 3),
        (0, 4),
    ] {
        // Not around 0, where next to nothing is left of a sum.
        let x: Vec<f32> = waves(rows * columns, 1.0).iter().map(|v| v + 0.5).collect();
        let run = |on: Option<&Device>| {
            value_and_gradients(&[(&x, columns)], on, |t| {
                sum_all(t[0].clone() * t[0].clone()).reshape([1, 1])
            })
        };
        let got = on_device(Some(&gpu), || run(Some(&gpu)));
        for ((got, want), name) in got.iter().zip(&run(None)).zip(["sum", "gradient"]) {
            assert_close(got, want, 1e-6, &format!("{name} of {rows} x {columns}"));
        }
        assert_eq!(got, run(Some(&gpu)), "the same bits each time");
    }
}
