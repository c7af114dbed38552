//! The same numbers in f32 on a GPU and in f64 on the CPU, and what operations make of them.

use burn::tensor::{DType, Device, Tensor, TensorData};

/// Numbers up to twice `amplitude`, of both signs.
pub fn waves(count: usize, amplitude: f32) -> Vec<f32> {
    (0..count)
        .map(|i| amplitude * (i as f32 * 1.7 + 0.3).sin() * (1.0 + (i as f32 * 0.31).cos()))
        .collect()
}

/// `values` as a leaf of `[rows, columns]`: f32 on `gpu`, or f64 on the CPU.
pub fn leaf(values: &[f32], columns: usize, gpu: Option<&Device>) -> Tensor<2> {
    let shape = [values.len() / columns, columns];
    match gpu {
        Some(device) => Tensor::from_data(
            TensorData::new(values.to_vec(), shape),
            (device, DType::F32),
        ),
        None => {
            let wide: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
            Tensor::from_data(
                TensorData::new(wide, shape),
                (&crate::support::device().autodiff(), DType::F64),
            )
        }
    }
    .require_grad()
}

/// The values in f64.
pub fn host<const D: usize>(t: Tensor<D>) -> Vec<f64> {
    t.into_data().convert::<f64>().into_vec().expect("f64")
}

/// Largest difference over the largest of `want`.
#[track_caller]
pub fn assert_close(got: &[f64], want: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let scale = want.iter().fold(f64::MIN_POSITIVE, |m, v| m.max(v.abs()));
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        assert!(
            (got - want).abs() <= tolerance * scale,
            "{what} {i}: {got} for {want}, of {scale}"
        );
    }
}

/// What `f` gives for each of `leaves` (values, columns), and the gradients of a sum weighted differently everywhere.
pub fn value_and_gradients(
    leaves: &[(&[f32], usize)],
    gpu: Option<&Device>,
    f: impl Fn(&[Tensor<2>]) -> Tensor<2>,
) -> Vec<Vec<f64>> {
    let leaves: Vec<Tensor<2>> = leaves
        .iter()
        .map(|(values, columns)| leaf(values, *columns, gpu))
        .collect();
    let out = f(&leaves);
    let [rows, columns] = out.dims();
    let towards = leaf(&waves(rows * columns, 1.1), columns, gpu).detach();
    let gradients = (out.clone() * towards).sum().backward();
    let mut found = vec![host(out.inner())];
    found.extend(
        leaves
            .iter()
            .map(|leaf| host(leaf.grad(&gradients).expect("tracked"))),
    );
    found
}
