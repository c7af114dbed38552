//! The two scalar types of the kernels.

#[cfg(target_arch = "x86_64")]
use super::avx::Avx;
use super::vector::Plain;
use super::vector::Vector;
use ndarray::LinalgScalar;
use num_traits::{Float, NumAssign};
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
    /// Whether kernels have a second copy on x86-64, for AVX2 with FMA.
    const WIDE: bool;
    /// The vectors of that copy.
    type Wide: Vector<Self>;
    /// Rounds an `f64` constant to this type.
    fn of(value: f64) -> Self;
    /// The value as `f64`, exact.
    fn wide(self) -> f64;
    /// `self * b + c`; one rounding when `FUSED`, which callers may set only where the hardware has the instruction.
    fn fma<const FUSED: bool>(self, b: Self, c: Self) -> Self;
    /// `2^self` for `self <= 0`, without branches. `f32`: a polynomial, relative error below 2e-7 down to -125, and below
    /// that `2^-125`. `f64`: the library function.
    fn exp2_nonpositive<const FUSED: bool>(self) -> Self;
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
    ($type:ty, $variant:ident, $exp2:ident, $wide:expr, $vector:ty) => {
        impl Real for $type {
            const WIDE: bool = $wide;
            type Wide = $vector;
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $type
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn fma<const FUSED: bool>(self, b: Self, c: Self) -> Self {
                if FUSED {
                    self.mul_add(b, c)
                } else {
                    self * b + c
                }
            }
            #[inline(always)]
            fn exp2_nonpositive<const FUSED: bool>(self) -> Self {
                $exp2::<FUSED>(self)
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
#[cfg(target_arch = "x86_64")]
real!(f32, F32, exp2_f32, true, Avx);
#[cfg(not(target_arch = "x86_64"))]
real!(f32, F32, exp2_f32, false, Plain<f32, false>);
real!(f64, F64, exp2_f64, false, Plain<f64, false>);

/// Constants of the `f32` exponential.
pub(crate) mod exp2_coefficients {
    /// Adding 1.5 2^23 rounds to an integer and leaves it in the low bits.
    pub const ROUND: f32 = 12_582_912.0;
    /// Smallest exponent of two.
    pub const LOWEST: f32 = -125.0;
    /// Minimax polynomial of `2^f` on -0.5..=0.5, highest power first; relative error 7.5e-8.
    #[expect(
        clippy::approx_constant,
        reason = "a minimax coefficient near ln 2, not ln 2"
    )]
    pub const POLYNOMIAL: [f32; 6] = [
        1.327_647_2e-3,
        9.675_541e-3,
        5.550_713_3e-2,
        2.402_212e-1,
        6.931_47e-1,
        1.000_000_1,
    ];
}

/// `2^(n + f)`: `n` the nearest integer of `x`.
#[inline(always)]
fn exp2_f32<const FUSED: bool>(x: f32) -> f32 {
    use exp2_coefficients::{LOWEST, POLYNOMIAL, ROUND};
    let y = if x > LOWEST { x } else { LOWEST };
    let shifted = y + ROUND;
    let f = y - (shifted - ROUND);
    let [top, rest @ ..] = POLYNOMIAL;
    let mut p = top;
    for c in rest {
        p = p.fma::<FUSED>(f, c);
    }
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[inline(always)]
fn exp2_f64<const FUSED: bool>(x: f64) -> f64 {
    x.exp2()
}
