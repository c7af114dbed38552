//! `f32` vectors in AVX2 registers.

use super::real::exp2_coefficients;
use super::vector::{LANES, Vector};
use std::arch::x86_64::*;

/// Eight `f32` in one register. Only [`super::simd::dispatch`] gives kernels this type, and only where AVX2 and FMA are present:
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
    fn max(self, b: Self) -> Self {
        Self(avx!(_mm256_max_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn minus_abs(self) -> Self {
        Self(avx!(_mm256_or_ps(_mm256_set1_ps(-0.0), self.0)))
    }
    #[inline(always)]
    fn select_above(self, b: Self, yes: Self, no: Self) -> Self {
        Self(avx!(_mm256_blendv_ps(
            no.0,
            yes.0,
            _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, b.0)
        )))
    }
    #[inline(always)]
    fn bits_above(self, b: Self) -> u32 {
        avx!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, b.0))) as u32
    }
    #[inline(always)]
    fn keep_above(self, a: Self, b: Self) -> Self {
        Self(avx!(_mm256_and_ps(
            _mm256_cmp_ps::<_CMP_GT_OQ>(a.0, b.0),
            self.0
        )))
    }
    #[inline(always)]
    fn keep_from(self, low: Self) -> Self {
        Self(avx!(_mm256_and_ps(
            _mm256_cmp_ps::<_CMP_GE_OQ>(self.0, low.0),
            self.0
        )))
    }
    #[inline(always)]
    fn exp2_nonpositive(self) -> Self {
        let round = Self::splat(exp2_coefficients::ROUND);
        let y = self.max(Self::splat(exp2_coefficients::LOWEST));
        let shifted = y.add(round);
        let f = y.sub(shifted.sub(round));
        let [top, rest @ ..] = exp2_coefficients::POLYNOMIAL;
        let mut p = Self::splat(top);
        for c in rest {
            p = p.fma(f, Self::splat(c));
        }
        let exponent = avx!(_mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.0)));
        Self(avx!(_mm256_castsi256_ps(_mm256_add_epi32(
            _mm256_castps_si256(p.0),
            exponent
        ))))
    }
    #[inline(always)]
    fn permute(self, from: &[u8; LANES]) -> Self {
        let from = avx!(_mm256_cvtepu8_epi32(_mm_cvtsi64_si128(i64::from_le_bytes(
            *from
        ))));
        Self(avx!(_mm256_permutevar8x32_ps(self.0, from)))
    }
    #[inline(always)]
    fn total(self) -> f32 {
        avx!({
            let x = _mm_add_ps(
                _mm256_castps256_ps128(self.0),
                _mm256_extractf128_ps::<1>(self.0),
            );
            let x = _mm_add_ps(x, _mm_movehl_ps(x, x));
            _mm_cvtss_f32(_mm_add_ss(x, _mm_shuffle_ps::<1>(x, x)))
        })
    }
}
