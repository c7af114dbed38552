//! Custom operations: adjointness, gradients, agreement with plain tensors.

use burn::tensor::{DType, Tensor, TensorData};
use coseg::ops::{SparseMatrix, sparse_apply, sparse_apply_plain};
use std::sync::Arc;

/// 3 x 4, one empty row.
fn matrix() -> SparseMatrix {
    SparseMatrix::new(
        4,
        vec![0, 2, 2, 5],
        vec![0, 3, 1, 2, 3],
        vec![0.5, 2.0, 1.0, -1.5, 0.25],
    )
}

fn dense(m: &SparseMatrix) -> Vec<f64> {
    let mut d = vec![0.0; m.rows() * m.columns()];
    for r in 0..m.rows() {
        let (columns, values) = m.row(r);
        for (&c, &v) in columns.iter().zip(values) {
            d[r * m.columns() + c as usize] += f64::from(v);
        }
    }
    d
}

#[test]
fn sparse_apply_equals_dense_product_and_its_adjoint() {
    let m = matrix();
    let d = dense(&m);
    for channels in [1, 3, 16, 37] {
        let x: Vec<f64> = (0..m.columns() * channels)
            .map(|i| (i as f64 * 0.7).sin())
            .collect();
        let g: Vec<f64> = (0..m.rows() * channels)
            .map(|i| (i as f64 * 1.3).cos())
            .collect();
        let (y, z) = (m.apply(&x, channels), m.apply_adjoint(&g, channels));
        for c in 0..channels {
            for r in 0..m.rows() {
                let want: f64 = (0..m.columns())
                    .map(|k| d[r * m.columns() + k] * x[k * channels + c])
                    .sum();
                assert!((y[r * channels + c] - want).abs() < 1e-12);
            }
            for k in 0..m.columns() {
                let want: f64 = (0..m.rows())
                    .map(|r| d[r * m.columns() + k] * g[r * channels + c])
                    .sum();
                assert!((z[k * channels + c] - want).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn sparse_apply_gradient_matches_plain_matmul() {
    let device = crate::support::device().autodiff();
    let m = matrix();
    let d: Vec<f32> = dense(&m).into_iter().map(|v| v as f32).collect();
    let dense = Tensor::<2>::from_data(TensorData::new(d, [3, 4]), &device);
    let values: Vec<f32> = (0..20).map(|i| (i as f32 * 0.7).sin()).collect();
    let input =
        || Tensor::<2>::from_data(TensorData::new(values.clone(), [4, 5]), &device).require_grad();
    let (a, b) = (input(), input());
    let ga = sparse_apply(a.clone(), Arc::new(m))
        .powi_scalar(2)
        .sum()
        .backward();
    let gb = dense.matmul(b.clone()).powi_scalar(2).sum().backward();
    let (ga, gb) = (a.grad(&ga).expect("tracked"), b.grad(&gb).expect("tracked"));
    let difference = (ga - gb).abs().max().into_scalar::<f32>();
    assert!(difference < 1e-5, "{difference}");
}

#[test]
fn sparse_apply_equals_its_reference_and_its_gradient_finite_differences() {
    let device = crate::support::device().autodiff();
    for channels in [1, 5, 37] {
        let values: Vec<f64> = (0..4 * channels).map(|i| (i as f64 * 0.7).sin()).collect();
        let input = |values: &[f64]| {
            let data = TensorData::new(values.to_vec(), [4, channels]);
            Tensor::<2>::from_data(data, (&device, DType::F64)).require_grad()
        };
        let run = |apply: &dyn Fn(Tensor<2>) -> Tensor<2>, values: &[f64]| {
            let x = input(values);
            let value = apply(x.clone()).powi_scalar(3).sum();
            let gradient = x.grad(&value.backward()).expect("tracked").into_data();
            let gradient = gradient.into_vec::<f64>().expect("f64");
            (value.into_scalar::<f64>(), gradient)
        };
        let op = |x| sparse_apply(x, Arc::new(matrix()));
        let (value, gradient) = run(&op, &values);
        let (plain, plain_gradient) = run(&|x| sparse_apply_plain(x, &matrix()), &values);
        assert!((value - plain).abs() < 1e-12);
        let rms = (gradient.iter().map(|g| g * g).sum::<f64>() / gradient.len() as f64).sqrt();
        for (i, got) in gradient.iter().enumerate() {
            assert!((got - plain_gradient[i]).abs() < 1e-12 * rms.max(1.0));
            let at = |by: f64| {
                let mut moved = values.clone();
                moved[i] += by;
                run(&op, &moved).0
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!(
                (got - numeric).abs() <= 1e-6 * got.abs().max(rms),
                "{i}: {got} for {numeric}"
            );
        }
    }
}
