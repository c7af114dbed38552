//! The fused Adam step against plain tensors and against a value worked out by hand.

use burn::tensor::{DType, Device, Tensor, TensorData};
use coseg::ops::{AdamStep, AdamTensors, adam_step, adam_step_plain};
use std::sync::Arc;

fn device() -> Device {
    crate::support::device()
}

fn wave(n: usize, frequency: f64) -> Vec<f64> {
    (0..n)
        .map(|i| (i as f64 * frequency).sin() * 10.0_f64.powi((i % 7) as i32 - 5))
        .collect()
}

fn worst(a: Tensor<2>, b: Tensor<2>) -> f64 {
    let read = |t: Tensor<2>| {
        t.into_data()
            .convert::<f64>()
            .into_vec::<f64>()
            .expect("f64")
    };
    let (a, b) = (read(a), read(b));
    let rms = (b.iter().map(|v| v * v).sum::<f64>() / b.len() as f64).sqrt();
    let worst = a
        .iter()
        .zip(&b)
        .map(|(a, b)| (a - b).abs())
        .fold(
            0.0,
            |m: f64, d| if d.is_nan() { f64::NAN } else { m.max(d) },
        );
    worst / rms
}

fn compare(dtype: DType, batch: u32, tolerance: f64) {
    let device = device();
    let shape = [1234, 7];
    let tensor = |v: Vec<f64>| Tensor::<2>::from_data(TensorData::new(v, shape), (&device, dtype));
    let n = shape[0] * shape[1];
    let start = || AdamTensors {
        param: tensor(wave(n, 0.3)),
        first: tensor(vec![0.0; n]),
        second: tensor(vec![0.0; n]),
    };
    let (mut fused, mut plain) = (start(), start());
    for step in 1..=20 {
        let gradient = tensor(wave(n, 0.1 * f64::from(step)));
        let rates = (1..=7).map(|k| 1e-3 * f64::from(k)).collect();
        let step = Arc::new(AdamStep {
            rates,
            views: step * batch,
            batch,
        });
        fused = adam_step(fused, gradient.clone(), &step);
        plain = adam_step_plain(plain, gradient, &step);
    }
    for (name, a, b) in [
        ("param", fused.param, plain.param),
        ("first moment", fused.first, plain.first),
        ("second moment", fused.second, plain.second),
    ] {
        let error = worst(a, b);
        assert!(error < tolerance, "{name}: {error}");
    }
}

#[test]
fn fused_step_equals_plain_tensors() {
    for batch in [1, 4] {
        compare(DType::F32, batch, 2e-6);
        compare(DType::F64, batch, 1e-13);
    }
}

/// With one constant gradient each bias-corrected step is the rate, whatever the gradient's size.
#[test]
fn first_steps_move_by_the_rate() {
    let step = |t| AdamStep::splatting(vec![0.5, 0.25], t);
    let (mut p, mut m, mut v) = (vec![0.0_f64; 6], vec![0.0; 6], vec![0.0; 6]);
    let g = [1e-9, -1e-3, 1.0, 7.0, -1e6, 0.0];
    for t in 1..=3 {
        step(t).apply(&mut p, &g, &mut m, &mut v);
    }
    let want = [-1.5, 0.75, -1.5, -0.75, 1.5, 0.0];
    for (p, want) in p.iter().zip(want) {
        assert!((p - want).abs() < 1e-4, "{p} against {want}");
    }
}

#[test]
fn same_bits_at_any_thread_count() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| {
            let n = 100_003;
            let gradient: Vec<f32> = wave(n, 0.7).into_iter().map(|v| v as f32).collect();
            let (mut p, mut m, mut v) = (vec![1.0_f32; n], vec![0.0; n], vec![0.0; n]);
            for t in 1..=4 {
                AdamStep::splatting(vec![1e-2, 1e-3, 1e-4], t)
                    .apply(&mut p, &gradient, &mut m, &mut v);
            }
            p
        })
    };
    assert_eq!(run(1), run(3));
}
