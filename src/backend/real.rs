//! The two scalar types of the kernels, and the check that values are finite.

use super::simd::{self, Kernel};
use crate::error::{Error, Result};
use ndarray::LinalgScalar;
use num_traits::{Float, NumAssign};
use rayon::prelude::*;
use std::iter::Sum;

/// `f32` (training) or `f64` (reference, finite differences).
pub trait Real:
    Float
    + NumAssign
    + Sum
    + Default
    + Send
    + Sync
    + std::fmt::Debug
    + burn::tensor::Element
    + LinalgScalar
{
    /// 0, 1, 2, ...
    const RAMP: [Self; 16];
    /// Rounds an `f64` constant to this type.
    fn of(value: f64) -> Self;
    /// The value as `f64`, exact.
    fn wide(self) -> f64;
    /// Runs `kernel` with the widest instructions that it is compiled for and this processor has.
    fn dispatch<K: Kernel<Self>>(kernel: K) -> K::Output;
    /// The row-major values of an ndarray-backend tensor of this element type.
    #[cfg(feature = "ndarray")]
    fn of_ndarray(
        tensor: burn::backend::ndarray::NdArrayTensor,
    ) -> Option<burn::backend::ndarray::SharedArray<Self>>;
    /// An ndarray-backend tensor of these values.
    #[cfg(feature = "ndarray")]
    fn into_ndarray(
        array: burn::backend::ndarray::SharedArray<Self>,
    ) -> burn::backend::ndarray::NdArrayTensor;
    /// The row-major values of a flex tensor of this element type, where they lie in order.
    #[cfg(feature = "flex")]
    fn of_flex(tensor: &burn::backend::flex::FlexTensor) -> Option<&[Self]>;
}

macro_rules! real {
    ($type:ident, $variant:ident, $dispatch:ident) => {
        impl Real for $type {
            const RAMP: [Self; 16] = [
                0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0,
                15.0,
            ];
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $type
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                f64::from(self)
            }
            fn dispatch<K: Kernel<Self>>(kernel: K) -> K::Output {
                simd::$dispatch(kernel)
            }
            #[cfg(feature = "ndarray")]
            fn of_ndarray(
                tensor: burn::backend::ndarray::NdArrayTensor,
            ) -> Option<burn::backend::ndarray::SharedArray<Self>> {
                match tensor {
                    burn::backend::ndarray::NdArrayTensor::$variant(storage) => {
                        Some(storage.into_shared())
                    }
                    _ => None,
                }
            }
            #[cfg(feature = "ndarray")]
            fn into_ndarray(
                array: burn::backend::ndarray::SharedArray<Self>,
            ) -> burn::backend::ndarray::NdArrayTensor {
                array.into()
            }
            #[cfg(feature = "flex")]
            fn of_flex(tensor: &burn::backend::flex::FlexTensor) -> Option<&[Self]> {
                tensor.as_slice()
            }
        }
    };
}
real!(f32, F32, dispatch_f32);
real!(f64, F64, dispatch_f64);

/// [`Error::NonFinite`] naming the first row of `[rows, width]` values that holds a NaN or an infinity.
pub(crate) fn check_finite<E: Real>(name: &str, values: &[E], width: usize) -> Result<()> {
    // Counting vectorises where stopping at the first would not.
    let finite = values
        .par_chunks(1 << 14)
        .all(|chunk| chunk.iter().map(|v| u32::from(!v.is_finite())).sum::<u32>() == 0);
    if finite {
        return Ok(());
    }
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(Error::non_finite(name, at / width.max(1))),
        None => Ok(()),
    }
}
