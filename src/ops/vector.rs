//! Vectors of lanes: one kernel source, compiled for several instruction sets, chosen at run time.
//!
//! A [`Kernel`]'s `run` is `#[inline(always)]`: it is inlined into a function with wider instructions enabled. Baseline
//! x86-64 costs several times as much. `f32` on AVX2 uses intrinsics (the compiler's own vectoriser gives up on chains as
//! long as an exponential); everything else is plain loops over lanes, which it handles well enough.

use super::Real;

/// Numbers handled together.
pub const LANES: usize = 8;

/// Work to be compiled once per instruction set.
pub(crate) trait Kernel<E> {
    type Output;
    fn run<V: Vector<E>>(self) -> Self::Output;
}

/// `LANES` numbers.
pub trait Vector<E>: Copy {
    fn splat(x: E) -> Self;
    /// 0, 1, 2, ...
    fn ramp() -> Self;
    fn load(from: &[E; LANES]) -> Self;
    fn store(self, to: &mut [E; LANES]);
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    fn div(self, b: Self) -> Self;
    /// `self * b + c`, in one rounding where the hardware can.
    fn fma(self, b: Self, c: Self) -> Self;
    /// `c - self * b`, in one rounding where the hardware can.
    fn fnma(self, b: Self, c: Self) -> Self;
    fn min(self, b: Self) -> Self;
    fn abs(self) -> Self;
    /// `yes` where `self > b`, else `no`.
    fn select_above(self, b: Self, yes: Self, no: Self) -> Self;
    /// [`Real::exp_nonpositive`].
    fn exp_nonpositive(self) -> Self;
    /// The sum of all lanes, in a fixed tree.
    fn total(self) -> E;
}

/// Lanes as an array. `FUSED`: the hardware multiplies and adds with one rounding.
#[derive(Clone, Copy)]
pub struct Plain<E, const FUSED: bool>([E; LANES]);

impl<E: Real, const FUSED: bool> Plain<E, FUSED> {
    #[inline(always)]
    fn zip(self, b: Self, f: impl Fn(E, E) -> E) -> Self {
        let mut out = self;
        for l in 0..LANES {
            out.0[l] = f(self.0[l], b.0[l]);
        }
        out
    }
}

impl<E: Real, const FUSED: bool> Vector<E> for Plain<E, FUSED> {
    #[inline(always)]
    fn splat(x: E) -> Self {
        Self([x; LANES])
    }
    #[inline(always)]
    fn ramp() -> Self {
        Self([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0].map(E::of))
    }
    #[inline(always)]
    fn load(from: &[E; LANES]) -> Self {
        Self(*from)
    }
    #[inline(always)]
    fn store(self, to: &mut [E; LANES]) {
        *to = self.0;
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.zip(b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        self.zip(b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.zip(b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        self.zip(b, |a, b| a / b)
    }
    #[inline(always)]
    fn fma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for l in 0..LANES {
            out.0[l] = self.0[l].fma::<FUSED>(b.0[l], c.0[l]);
        }
        out
    }
    #[inline(always)]
    fn fnma(self, b: Self, c: Self) -> Self {
        let mut out = c;
        for l in 0..LANES {
            out.0[l] = (-self.0[l]).fma::<FUSED>(b.0[l], c.0[l]);
        }
        out
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        self.zip(b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.zip(self, |a, _| a.abs())
    }
    #[inline(always)]
    fn select_above(self, b: Self, yes: Self, no: Self) -> Self {
        let mut out = no;
        for l in 0..LANES {
            out.0[l] = if self.0[l] > b.0[l] { yes.0[l] } else { no.0[l] };
        }
        out
    }
    #[inline(always)]
    fn exp_nonpositive(self) -> Self {
        self.zip(self, |a, _| a.exp_nonpositive::<FUSED>())
    }
    #[inline(always)]
    fn total(self) -> E {
        let v = self.0;
        let half = |i: usize| v[i] + v[i + 4];
        (half(0) + half(2)) + (half(1) + half(3))
    }
}

/// The vectors of `f32` where AVX2 and FMA are present.
#[cfg(target_arch = "x86_64")]
pub type WideF32 = x86::Avx;
/// The vectors of `f32`: 128-bit units with fused multiply-add are part of aarch64.
#[cfg(not(target_arch = "x86_64"))]
pub type WideF32 = Plain<f32, { cfg!(target_arch = "aarch64") }>;
/// The vectors of `f64` where fused multiply-add is present.
pub type WideF64 = Plain<f64, { cfg!(any(target_arch = "x86_64", target_arch = "aarch64")) }>;

/// Runs `kernel` with the widest instructions that this processor has.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn dispatch<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
    kernel.run::<E::Wide>()
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::dispatch;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::real::exp2_coefficients;
    use super::{Kernel, LANES, Plain, Vector};
    use crate::ops::Real;
    use std::arch::x86_64::*;

    /// Runs `kernel` with the widest instructions that this processor has.
    pub(crate) fn dispatch<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            return kernel.run::<Plain<E, false>>();
        }
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl") {
            // SAFETY: the processor has the features, checked above.
            unsafe { with_avx512(kernel) }
        } else {
            // SAFETY: as above.
            unsafe { with_avx2(kernel) }
        }
    }

    /// The same code as [`with_avx2`], with twice the registers.
    #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
    fn with_avx512<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
        kernel.run::<E::Wide>()
    }

    #[target_feature(enable = "avx2,fma")]
    fn with_avx2<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
        kernel.run::<E::Wide>()
    }

    /// Eight `f32` in one register. Only [`dispatch`] gives kernels this type, and only where AVX2 and FMA are present:
    /// that is the safety of every intrinsic below.
    #[derive(Clone, Copy)]
    pub struct Avx(__m256);

    /// An intrinsic call under the guarantee stated at [`Avx`].
    macro_rules! avx {
        ($call:expr) => {
            // SAFETY: see `Avx`.
            unsafe { $call }
        };
    }

    impl Vector<f32> for Avx {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(avx!(_mm256_set1_ps(x)))
        }
        #[inline(always)]
        fn ramp() -> Self {
            Self(avx!(_mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)))
        }
        #[inline(always)]
        fn load(from: &[f32; LANES]) -> Self {
            Self(avx!(_mm256_loadu_ps(from.as_ptr())))
        }
        #[inline(always)]
        fn store(self, to: &mut [f32; LANES]) {
            avx!(_mm256_storeu_ps(to.as_mut_ptr(), self.0));
        }
        #[inline(always)]
        fn add(self, b: Self) -> Self {
            Self(avx!(_mm256_add_ps(self.0, b.0)))
        }
        #[inline(always)]
        fn sub(self, b: Self) -> Self {
            Self(avx!(_mm256_sub_ps(self.0, b.0)))
        }
        #[inline(always)]
        fn mul(self, b: Self) -> Self {
            Self(avx!(_mm256_mul_ps(self.0, b.0)))
        }
        #[inline(always)]
        fn div(self, b: Self) -> Self {
            Self(avx!(_mm256_div_ps(self.0, b.0)))
        }
        #[inline(always)]
        fn fma(self, b: Self, c: Self) -> Self {
            Self(avx!(_mm256_fmadd_ps(self.0, b.0, c.0)))
        }
        #[inline(always)]
        fn fnma(self, b: Self, c: Self) -> Self {
            Self(avx!(_mm256_fnmadd_ps(self.0, b.0, c.0)))
        }
        #[inline(always)]
        fn min(self, b: Self) -> Self {
            Self(avx!(_mm256_min_ps(self.0, b.0)))
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(avx!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
        }
        #[inline(always)]
        fn select_above(self, b: Self, yes: Self, no: Self) -> Self {
            Self(avx!(_mm256_blendv_ps(no.0, yes.0, _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, b.0))))
        }
        #[inline(always)]
        fn exp_nonpositive(self) -> Self {
            let round = Self::splat(exp2_coefficients::ROUND);
            let y = self.mul(Self::splat(std::f32::consts::LOG2_E));
            let y = Self(avx!(_mm256_max_ps(y.0, _mm256_set1_ps(exp2_coefficients::LOWEST))));
            let shifted = y.add(round);
            let f = y.sub(shifted.sub(round));
            let [top, rest @ ..] = exp2_coefficients::POLYNOMIAL;
            let mut p = Self::splat(top);
            for c in rest {
                p = p.fma(f, Self::splat(c));
            }
            let exponent = avx!(_mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.0)));
            Self(avx!(_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p.0), exponent))))
        }
        #[inline(always)]
        fn total(self) -> f32 {
            let mut v = [0.0; LANES];
            self.store(&mut v);
            Plain::<f32, true>::load(&v).total()
        }
    }
}
