//! What a step of training has besides rasterizing and losses, on a GPU: optimiser, running means, the look at gradients,
//! the decoder's layer, Eq. 9. Against the CPU's kernels in f64, fed the same f32 numbers.

use crate::ops::device_ops::{assert_close, host, leaf, uneven, value_and_gradients, waves};
use burn::tensor::{Device, Tensor, TensorData};
use coseg::backend::host_fallbacks;
use coseg::ops::{
    AdamStep, AdamTensors, FiniteCheck, LayerMap, NeighbourPairs, RowList, SparseMatrix, adam_step,
    fusion_layer, gather_rows, neighbour_divergence, sum_all,
};
use std::sync::Arc;

/// What `f` gives, none of whose tensors went to the CPU's kernels when it ran on a GPU.
pub fn on_device<T>(on: Option<&Device>, f: impl FnOnce() -> T) -> T {
    let before = host_fallbacks();
    let out = f();
    assert!(
        on.is_none() || host_fallbacks() == before,
        "{} tensors went to the host",
        host_fallbacks() - before
    );
    out
}

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
                    &Arc::new(AdamStep::splatting(rates.clone(), step)),
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
fn one_value_that_is_not_finite_is_seen() {
    for device in crate::support::gpu()
        .into_iter()
        .chain([crate::support::device()])
    {
        let tensor = |values: &[f32]| {
            Tensor::<1>::from_data(TensorData::new(values.to_vec(), [values.len()]), &device)
        };
        let look = |loss: f32, bad: Option<(usize, f32)>| {
            let mut check = FiniteCheck::default();
            for length in [1, 700, 5000] {
                let mut values = waves(length, 1e30);
                if let Some((place, value)) = bad.filter(|_| length == 700) {
                    values[place] = value;
                }
                check.add(&tensor(&values));
            }
            check.read(tensor(&[loss])).expect("readable")
        };
        assert_eq!(look(0.25, None), (0.25, true), "{device:?}");
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for place in [0, 333, 699] {
                assert_eq!(
                    look(0.25, Some((place, value))),
                    (0.25, false),
                    "{value} at {place} on {device:?}"
                );
            }
        }
        let (loss, finite) = look(f32::NAN, None);
        assert!(loss.is_nan() && !finite, "{device:?}");
        assert_eq!(
            FiniteCheck::default()
                .read(tensor(&[7.0]))
                .expect("readable"),
            (7.0, true)
        );
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
        // Neighbours that are sampled too, rows that are many's neighbour and rows that are nobody's.
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
                neighbour_divergence(t[0].clone(), pairs.clone()).reshape([1, 1])
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

#[test]
fn rows_by_their_numbers() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let some = |count: u32, of: u32| (0..count).map(|r| r * of / count).collect::<Vec<_>>();
    // In order, out of order, all, none, and one that is named twice.
    let out_of_order: Vec<u32> = (0..83).map(|r| (r * 7 + 3) % 97).collect();
    let twice: Vec<u32> = some(40, 97).into_iter().chain([5, 5, 96, 0]).collect();
    for (rows, channels) in [
        (some(1, 97), 1),
        (some(60, 97), 5),
        (some(97, 97), 64),
        (out_of_order, 3),
        (twice, 7),
        (Vec::new(), 4),
    ] {
        let list = Arc::new(RowList::from(rows.clone()));
        let x = waves(97 * channels, 1.0);
        let run = |on: Option<&Device>| {
            value_and_gradients(&[(&x, channels)], on, |t| gather_rows(t[0].clone(), &list))
        };
        // Twice: the device keeps the list.
        for _ in 0..2 {
            let got = on_device(Some(&gpu), || run(Some(&gpu)));
            for ((got, want), name) in got.iter().zip(&run(None)).zip(["rows", "gradient"]) {
                assert_close(
                    got,
                    want,
                    1e-6,
                    &format!("{name}: {} rows, {channels} channels", rows.len()),
                );
            }
        }
    }
}

#[test]
fn layers_of_the_decoder() {
    let Some(gpu) = crate::support::gpu().map(Device::autodiff) else {
        return;
    };
    let some: Vec<u32> = (0..83).map(|r| (r * 7 + 3) % 97).collect();
    for (rows, inputs, slope) in [
        (Some(some.clone()), 6, 0.2),
        (None, 6, 0.2),
        (Some(some.clone()), 6, 1.0),
        (Some(some), 0, 0.2),
    ] {
        let count = rows.as_ref().map_or(97, Vec::len);
        let map = LayerMap {
            rows: rows.map(|rows| Arc::new(rows.into())),
            upsample: Arc::new(uneven(count, 31)),
            slope,
        };
        let (x, weight, below, bias) = (
            waves(97 * inputs, 1.0),
            waves(inputs * 9, 0.5),
            waves(31 * 9, 0.7),
            waves(9, 0.3),
        );
        let run = |on: Option<&Device>| {
            let given = [
                (&below[..], 9),
                (&bias[..], 9),
                (&x[..], inputs),
                (&weight[..], 9),
            ];
            value_and_gradients(if inputs > 0 { &given } else { &given[..2] }, on, |t| {
                let empty =
                    |shape: [usize; 2]| Tensor::zeros(shape, (&t[0].device(), t[0].dtype()));
                let [x, weight] = if inputs > 0 {
                    [t[2].clone(), t[3].clone()]
                } else {
                    [empty([97, 0]), empty([0, 9])]
                };
                fusion_layer(
                    x,
                    weight,
                    t[0].clone(),
                    t[1].clone().reshape([9]),
                    map.clone(),
                )
            })
        };
        let what = format!(
            "{inputs} inputs, slope {slope}, {} rows",
            map.upsample.rows()
        );
        let names = ["value", "below", "bias", "x", "weight"];
        let got = on_device(Some(&gpu), || run(Some(&gpu)));
        for ((got, want), name) in got.iter().zip(&run(None)).zip(names) {
            assert_close(got, want, 1e-5, &format!("{name}: {what}"));
        }
    }
    // Frozen features get no gradient, and nothing is computed for them.
    let map = LayerMap {
        rows: None,
        upsample: Arc::new(SparseMatrix::selection(vec![0, 1, 1], 2)),
        slope: 0.2,
    };
    let frozen = Tensor::from_inner(leaf(&waves(12, 1.0), 4, Some(&gpu)).inner());
    let (weight, below) = (
        leaf(&waves(8, 1.0), 2, Some(&gpu)),
        leaf(&waves(4, 1.0), 2, Some(&gpu)),
    );
    let bias = leaf(&[0.1, 0.2], 2, Some(&gpu)).reshape([2]);
    let gradients = fusion_layer(frozen.clone(), weight.clone(), below, bias, map)
        .sum()
        .backward();
    assert!(frozen.grad(&gradients).is_none() && weight.grad(&gradients).is_some());
}
