//! Checks that all gradients are finite, in one readback with the loss.

use super::sum_all;
use crate::backend::device::read;
use crate::error::Result;
use burn::tensor::Tensor;

/// Sums of tensors of f32 without autodiff. A NaN or an infinity always reaches the sum.
#[derive(Clone, Debug, Default)]
pub struct FiniteCheck {
    sums: Vec<Tensor<1>>,
}

impl FiniteCheck {
    /// Looks at `values`.
    pub fn add<const D: usize>(&mut self, values: &Tensor<D>) {
        self.sums.push(sum_all(values.clone()));
    }

    /// The value of `loss` (`[1]`, without autodiff), and whether it and all values are finite. `false` may also mean that a
    /// sum overflowed.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return the values.
    pub fn read(self, loss: Tensor<1>) -> Result<(f32, bool)> {
        let all = std::iter::once(loss).chain(self.sums);
        let found = read("loss", Tensor::cat(all.collect(), 0))?;
        let finite = found.iter().all(|value| value.is_finite());
        Ok((found[0], finite))
    }
}
