//! The probes of a device as operations on tensors that live there.

use super::gpu::{CHAINS, STEPS};
use crate::backend::device::read;
use crate::error::Result;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

/// They lead to 2, from anywhere, and so neither overflow nor vanish.
const FACTOR: f32 = 0.75;
const TERM: f32 = 0.5;

/// Kernels that show what a device can do at most.
#[backend_extension(Cube: cfg(feature = "cube"))]
pub trait ProbeBackend: Backend {
    /// Copies `from` over `to`, `passes` times; both are `[n]`, n a multiple of 4. Gives `to`.
    fn probe_copy(
        from: FloatTensor<Self>,
        to: FloatTensor<Self>,
        passes: usize,
    ) -> FloatTensor<Self>;
    /// `[n]`: for each of `starts` (`[n]`) the sum of 8 chains `x = x factor + term` of `16 rounds` steps, from it and the seven numbers
    /// above it.
    fn probe_chains(
        starts: FloatTensor<Self>,
        factor: f32,
        term: f32,
        rounds: usize,
    ) -> FloatTensor<Self>;
    /// Adds 1 to `cell` (`[1]`) so many times, a kernel each. Gives `cell`.
    fn probe_launches(cell: FloatTensor<Self>, launches: usize) -> FloatTensor<Self>;
}

/// Copies `from` over `to`, `passes` times, and waits.
pub(super) fn copy(from: &Tensor<1>, to: &Tensor<1>, passes: usize) -> Result<()> {
    let copied = Dispatch::probe_copy(
        from.clone().into_dispatch(),
        to.clone().into_dispatch(),
        passes,
    );
    wait(Tensor::from_dispatch(copied))
}

/// Runs the chains of `starts` for `rounds` rounds, and waits.
pub(super) fn multiply_add(starts: &Tensor<1>, rounds: usize) -> Result<()> {
    wait(Tensor::from_dispatch(Dispatch::probe_chains(
        starts.clone().into_dispatch(),
        FACTOR,
        TERM,
        rounds,
    )))
}

/// Operations of a round over `starts` starts, two a multiply-add.
pub(super) fn operations_of_a_round(starts: usize) -> f64 {
    2.0 * (starts * CHAINS * STEPS) as f64
}

/// Launches so many kernels that add 1 to `cell`, and waits.
pub(super) fn launches(cell: &Tensor<1>, count: usize) -> Result<()> {
    wait(Tensor::from_dispatch(Dispatch::probe_launches(
        cell.clone().into_dispatch(),
        count,
    )))
}

/// Reads the first value back.
pub(super) fn wait(tensor: Tensor<1>) -> Result<()> {
    read("a value of a probe", tensor.narrow(0, 0, 1)).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use burn::tensor::{Device, TensorData};

    /// The default device, if this machine has one.
    fn gpu() -> Option<Device> {
        gpu_of_tests()
    }

    fn ramp(len: usize, device: &Device) -> Tensor<1> {
        let values: Vec<f32> = (0..len).map(|i| (i % 97) as f32).collect();
        Tensor::from_data(TensorData::new(values, [len]), device)
    }

    #[test]
    fn a_copy_is_whole() {
        let Some(device) = gpu() else { return };
        for len in [4, 1000, 300_000] {
            let (from, to) = (ramp(len, &device), Tensor::<1>::zeros([len], &device));
            copy(&from, &to, 2).expect("a working device");
            assert_eq!(
                read("copy", to).expect("floats"),
                read("source", from).expect("floats")
            );
        }
    }

    #[test]
    fn chains_are_what_plain_steps_give() {
        let Some(device) = gpu() else { return };
        for rounds in [0, 1, 3] {
            let starts = ramp(1000, &device).into_dispatch();
            let sums =
                Tensor::<1>::from_dispatch(Dispatch::probe_chains(starts, FACTOR, TERM, rounds));
            for (i, sum) in read("sums", sums).expect("floats").into_iter().enumerate() {
                let chain = |x: f32| (0..rounds * STEPS).fold(x, |x, _| x * FACTOR + TERM);
                let want: f32 = (0..CHAINS).map(|k| chain((i % 97 + k) as f32)).sum();
                assert!(
                    (sum - want).abs() <= 1e-5 * want,
                    "{rounds} rounds from {i}: {sum}, expected {want}"
                );
            }
        }
        multiply_add(&ramp(5, &device), 1).expect("a working device");
        assert_eq!(operations_of_a_round(3), 768.0);
    }

    #[test]
    fn every_launch_counts() {
        let Some(device) = gpu() else { return };
        let cell = Tensor::<1>::zeros([1], &device);
        launches(&cell, 300).expect("a working device");
        launches(&cell, 5).expect("a working device");
        assert_eq!(read("cell", cell).expect("a float"), [305.0]);
    }
}
