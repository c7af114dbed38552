//! A look at gradients on their way to the optimiser: whether all are finite, told together with the loss in one readback.

#[cfg(feature = "cube")]
use crate::backend::device::in_host_memory;
use crate::backend::device::read;
use crate::error::Result;
use burn::tensor::Tensor;
#[cfg(feature = "cube")]
use burn::{
    backend::{
        Backend, Dispatch, backend_extension,
        tensor::{FloatTensor, IntTensor},
    },
    tensor::Int,
};

/// Counts on a GPU, for tensors that lie there.
#[cfg(feature = "cube")]
#[backend_extension(Cube: cfg(feature = "cube"))]
pub trait FiniteBackend: Backend {
    /// `count` (`[1]`) and the number of values that are NaN or infinite besides; its buffer may be reused.
    fn add_non_finite(count: IntTensor<Self>, values: FloatTensor<Self>) -> IntTensor<Self>;
    /// `loss` (`[1]`), `count` and `others` (`[n]`), `[2 + n]`.
    fn with_count(
        loss: FloatTensor<Self>,
        count: IntTensor<Self>,
        others: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
}

/// Tensors of f32 that were looked at.
#[derive(Clone, Debug, Default)]
pub struct FiniteCheck {
    /// Of what lies in host memory: a NaN or an infinity always reaches the sum.
    sums: Vec<Tensor<1>>,
    #[cfg(feature = "cube")]
    count: Option<Tensor<1, Int>>,
}

impl FiniteCheck {
    /// Looks at `values`, which have no autodiff.
    pub fn add<const D: usize>(&mut self, values: &Tensor<D>) {
        #[cfg(feature = "cube")]
        if !in_host_memory(&values.device()) {
            let count = self
                .count
                .take()
                .unwrap_or_else(|| Tensor::zeros([1], &values.device()));
            let count =
                Dispatch::add_non_finite(count.into_dispatch(), values.clone().into_dispatch());
            self.count = Some(Tensor::from_dispatch(count));
            return;
        }
        self.sums.push(values.clone().sum());
    }

    /// The value of `loss` (`[1]`, without autodiff), and whether it and all that was looked at are finite. In host memory `false`
    /// may also mean that a sum was beyond its type.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not give them back.
    pub fn read(self, loss: Tensor<1>) -> Result<(f32, bool)> {
        let (value, finite, _) = self.read_with(loss, None)?;
        Ok((value, finite))
    }

    /// [`FiniteCheck::read`], and the values of `others` (`[n]`, without autodiff) in the same readback.
    ///
    /// # Errors
    /// As [`FiniteCheck::read`].
    pub fn read_with(
        self,
        loss: Tensor<1>,
        others: Option<Tensor<1>>,
    ) -> Result<(f32, bool, Vec<f32>)> {
        let length = others.as_ref().map_or(0, |others| others.dims()[0]);
        let mut found = read("loss", self.beside(loss, others))?;
        let others = found.split_off(found.len().saturating_sub(length));
        let value = found.remove(0);
        #[cfg(feature = "cube")]
        if self.count.is_some() {
            return Ok((
                value,
                value.is_finite() && found.iter().all(|count| *count == 0.0),
                others,
            ));
        }
        Ok((
            value,
            value.is_finite() && found.iter().all(|sum| sum.is_finite()),
            others,
        ))
    }

    /// `loss`, what tells whether all is finite, and `others`.
    fn beside(&self, loss: Tensor<1>, others: Option<Tensor<1>>) -> Tensor<1> {
        #[cfg(feature = "cube")]
        if let Some(count) = &self.count {
            let others = others.unwrap_or_else(|| Tensor::empty([0], &loss.device()));
            let (loss, count) = (loss.into_dispatch(), count.clone().into_dispatch());
            return Tensor::from_dispatch(Dispatch::with_count(
                loss,
                count,
                others.into_dispatch(),
            ));
        }
        let all: Vec<_> = std::iter::once(loss)
            .chain(self.sums.iter().cloned())
            .chain(others)
            .collect();
        Tensor::cat(all, 0)
    }
}
