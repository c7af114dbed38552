//! The two scalar types of the kernels.

use num_traits::{Float, NumAssign};
use std::iter::Sum;

/// `f32` (training) or `f64` (reference, finite differences).
pub trait Real:
    Float + NumAssign + Sum + Default + Send + Sync + std::fmt::Debug + burn::tensor::Element + 'static
{
    /// Rounds an `f64` constant to this type.
    fn of(value: f64) -> Self;
    /// The value as `f64`, exact.
    fn wide(self) -> f64;
    /// The row-major values of an ndarray-backend tensor of this element type.
    #[cfg(feature = "ndarray")]
    fn of_ndarray(tensor: burn::backend::ndarray::NdArrayTensor) -> Option<burn::backend::ndarray::SharedArray<Self>>;
    /// An ndarray-backend tensor of these values.
    #[cfg(feature = "ndarray")]
    fn into_ndarray(array: burn::backend::ndarray::SharedArray<Self>) -> burn::backend::ndarray::NdArrayTensor;
}

macro_rules! real {
    ($type:ty, $variant:ident) => {
        impl Real for $type {
            fn of(value: f64) -> Self {
                value as $type
            }
            fn wide(self) -> f64 {
                f64::from(self)
            }
            #[cfg(feature = "ndarray")]
            fn of_ndarray(
                tensor: burn::backend::ndarray::NdArrayTensor,
            ) -> Option<burn::backend::ndarray::SharedArray<Self>> {
                match tensor {
                    burn::backend::ndarray::NdArrayTensor::$variant(storage) => Some(storage.into_shared()),
                    _ => None,
                }
            }
            #[cfg(feature = "ndarray")]
            fn into_ndarray(array: burn::backend::ndarray::SharedArray<Self>) -> burn::backend::ndarray::NdArrayTensor {
                array.into()
            }
        }
    };
}
real!(f32, F32);
real!(f64, F64);
