//! SIMD by `pulp`: kernels are written once, and run with the widest instructions that the processor has.
//!
//! A kernel over [`Lanes`] handles a register of numbers at a time: 8 `f32` with AVX2, 4 with NEON, and in builds with the
//! feature `avx512` 16 with AVX-512. Loops that the compiler vectorises by itself run in [`vectorized`].

mod operations;

use super::Real;
pub(crate) use operations::places;
use operations::{Operations, compressed, sign_bits};
use pulp::{Scalar512b, Simd};

/// Registers of `E` and what can be done with them.
///
/// Comparisons with NaN are false. `min` and `max` of a NaN are unspecified.
pub trait Lanes<E>: Copy {
    /// Numbers of a register.
    const LANES: usize;
    /// A register.
    type V: Copy + 'static;
    /// A comparison of two registers.
    type Mask: Copy;

    fn splat(self, x: E) -> Self::V;
    /// The whole registers of `x`.
    fn registers(x: &[E]) -> &[Self::V];
    fn registers_mut(x: &mut [E]) -> &mut [Self::V];
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`, in one rounding where the hardware can.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c - a b`, in one rounding where the hardware can.
    fn neg_mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `-|a|`.
    fn minus_abs(self, a: Self::V) -> Self::V;
    /// `a > b`.
    fn greater(self, a: Self::V, b: Self::V) -> Self::Mask;
    /// `a >= b`.
    fn at_least(self, a: Self::V, b: Self::V) -> Self::Mask;
    fn select(self, mask: Self::Mask, yes: Self::V, no: Self::V) -> Self::V;
    /// Bit `l` is set where lane `l` is true.
    fn bits(self, mask: Self::Mask) -> u32;
    /// The lanes whose bit is set, in order; what follows them is unspecified.
    fn compress(self, x: Self::V, bits: u32) -> Self::V;
    /// `x` where `mask`, else 0.
    fn keep(self, mask: Self::Mask, x: Self::V) -> Self::V;
    /// The sum of all lanes, in a fixed tree.
    fn total(self, a: Self::V) -> E;
    /// The sums of all lanes of eight registers, in fixed trees.
    fn totals(self, a: [Self::V; 8]) -> [E; 8];
    /// `2^x` for `x <= 0`. `f32`: a polynomial with relative error below 2e-7 down to -125, and `2^-125` below that.
    /// `f64`: the library function.
    fn exp2_nonpositive(self, x: Self::V) -> Self::V;

    /// 0, 1, 2, ...
    #[inline(always)]
    fn ramp(self) -> Self::V
    where
        E: Real,
    {
        Self::registers(&E::RAMP)[0]
    }

    /// Writes the sums of all lanes of `registers`.
    #[inline(always)]
    fn write_totals(self, registers: &[Self::V], out: &mut [E])
    where
        E: Copy,
    {
        let (eights, rest) = registers.as_chunks::<8>();
        let (out, out_rest) = out.split_at_mut(8 * eights.len());
        for (&eight, out) in eights.iter().zip(out.chunks_exact_mut(8)) {
            out.copy_from_slice(&self.totals(eight));
        }
        for (&register, out) in rest.iter().zip(out_rest) {
            *out = self.total(register);
        }
    }
}

/// The operations of [`Lanes`] that `pulp` has for both types, under these names.
macro_rules! operations {
    ($type:ident: $v:ident, $mask:ident, $registers:ident, $registers_mut:ident, $abs:ident, $neg:ident;
     $($name:ident = $function:ident($($arg:ident: $arg_type:ty),*) -> $out:ty;)*) => {
        const LANES: usize = size_of::<Self::V>() / size_of::<$type>();
        type V = <Self as Simd>::$v;
        type Mask = <Self as Simd>::$mask;
        #[inline(always)]
        fn registers(x: &[$type]) -> &[Self::V] {
            Self::$registers(x).0
        }
        #[inline(always)]
        fn registers_mut(x: &mut [$type]) -> &mut [Self::V] {
            Self::$registers_mut(x).0
        }
        #[inline(always)]
        fn minus_abs(self, a: Self::V) -> Self::V {
            self.$neg(self.$abs(a))
        }
        $(
            #[inline(always)]
            fn $name(self, $($arg: $arg_type),*) -> $out {
                self.$function($($arg),*)
            }
        )*
    };
}

impl<S: Operations> Lanes<f32> for S {
    operations! {
        f32: f32s, m32s, as_simd_f32s, as_mut_simd_f32s, abs_f32s, neg_f32s;
        splat = splat_f32s(x: f32) -> Self::V;
        add = add_f32s(a: Self::V, b: Self::V) -> Self::V;
        sub = sub_f32s(a: Self::V, b: Self::V) -> Self::V;
        mul = mul_f32s(a: Self::V, b: Self::V) -> Self::V;
        div = div_f32s(a: Self::V, b: Self::V) -> Self::V;
        min = min_f32s(a: Self::V, b: Self::V) -> Self::V;
        max = max_f32s(a: Self::V, b: Self::V) -> Self::V;
        mul_add = mul_add_e_f32s(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
        neg_mul_add = negate_mul_add_e_f32s(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
        greater = greater_than_f32s(a: Self::V, b: Self::V) -> Self::Mask;
        at_least = greater_than_or_equal_f32s(a: Self::V, b: Self::V) -> Self::Mask;
        select = select_f32s(mask: Self::Mask, yes: Self::V, no: Self::V) -> Self::V;
        bits = mask_bits(mask: Self::Mask) -> u32;
        compress = compress_f32s(x: Self::V, bits: u32) -> Self::V;
        keep = keep_f32s(mask: Self::Mask, x: Self::V) -> Self::V;
        totals = totals_f32s(a: [Self::V; 8]) -> [f32; 8];
        total = reduce_sum_f32s(a: Self::V) -> f32;
    }

    /// `2^(n + f)`: `n` is the nearest integer of `x`, `2^f` a polynomial, and `n` is added to its exponent.
    #[inline(always)]
    fn exp2_nonpositive(self, x: Self::V) -> Self::V {
        // Adding 1.5 2^23 rounds to an integer and leaves it in the low bits.
        let round = self.splat_f32s(12_582_912.0);
        let x = self.max_f32s(x, self.splat_f32s(-125.0));
        let shifted = self.add_f32s(x, round);
        let f = self.sub_f32s(x, self.sub_f32s(shifted, round));
        let [top, rest @ ..] = EXP2;
        let mut p = self.splat_f32s(top);
        for c in rest {
            p = self.mul_add_e_f32s(p, f, self.splat_f32s(c));
        }
        let n = self.transmute_u32s_f32s(shifted);
        let exponent = self.wrapping_dyn_shl_u32s(n, self.splat_u32s(23));
        self.transmute_f32s_u32s(self.add_u32s(self.transmute_u32s_f32s(p), exponent))
    }
}

/// Minimax polynomial of `2^f` on -0.5..=0.5, highest power first; relative error 7.5e-8.
#[expect(
    clippy::approx_constant,
    reason = "a minimax coefficient near ln 2, not ln 2"
)]
const EXP2: [f32; 6] = [
    1.327_647_2e-3,
    9.675_541e-3,
    5.550_713_3e-2,
    2.402_212e-1,
    6.931_47e-1,
    1.000_000_1,
];

impl Lanes<f64> for Scalar512b {
    operations! {
        f64: f64s, m64s, as_simd_f64s, as_mut_simd_f64s, abs_f64s, neg_f64s;
        splat = splat_f64s(x: f64) -> Self::V;
        add = add_f64s(a: Self::V, b: Self::V) -> Self::V;
        sub = sub_f64s(a: Self::V, b: Self::V) -> Self::V;
        mul = mul_f64s(a: Self::V, b: Self::V) -> Self::V;
        div = div_f64s(a: Self::V, b: Self::V) -> Self::V;
        min = min_f64s(a: Self::V, b: Self::V) -> Self::V;
        max = max_f64s(a: Self::V, b: Self::V) -> Self::V;
        mul_add = mul_add_e_f64s(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
        neg_mul_add = negate_mul_add_e_f64s(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
        greater = greater_than_f64s(a: Self::V, b: Self::V) -> Self::Mask;
        at_least = greater_than_or_equal_f64s(a: Self::V, b: Self::V) -> Self::Mask;
        select = select_f64s(mask: Self::Mask, yes: Self::V, no: Self::V) -> Self::V;
        total = reduce_sum_f64s(a: Self::V) -> f64;
    }

    #[inline(always)]
    fn bits(self, mask: Self::Mask) -> u32 {
        sign_bits(pulp::cast::<_, [i64; 8]>(mask).map(|lane| lane as i32))
    }

    #[inline(always)]
    fn compress(self, x: Self::V, bits: u32) -> Self::V {
        pulp::cast(compressed::<f64, 8>(pulp::cast(x), bits))
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask, x: Self::V) -> Self::V {
        self.select_f64s(mask, x, self.splat_f64s(0.0))
    }

    #[inline(always)]
    fn totals(self, a: [Self::V; 8]) -> [f64; 8] {
        a.map(|a| self.reduce_sum_f64s(a))
    }

    #[inline(always)]
    fn exp2_nonpositive(self, x: Self::V) -> Self::V {
        pulp::cast(pulp::cast::<_, [f64; 8]>(x).map(f64::exp2))
    }
}

/// Work over registers. `run` must be `#[inline(always)]`, so that it lands in a function with wider instructions.
pub trait Kernel<E> {
    type Output;
    fn run<S: Lanes<E>>(self, s: S) -> Self::Output;
}

/// Runs `kernel` with the widest instructions that this processor has, in a stack frame of its own.
#[inline(never)]
pub(super) fn dispatch_f32<K: Kernel<f32>>(kernel: K) -> K::Output {
    #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
    if let Some(s) = pulp::x86::V4::try_new() {
        return s.vectorize(
            #[inline(always)]
            || kernel.run(s),
        );
    }
    #[cfg(target_arch = "x86_64")]
    if let Some(s) = pulp::x86::V3::try_new() {
        return s.vectorize(
            #[inline(always)]
            || kernel.run(s),
        );
    }
    #[cfg(target_arch = "aarch64")]
    if let Some(s) = pulp::aarch64::Neon::try_new() {
        return kernel.run(s);
    }
    kernel.run(Scalar512b)
}

/// Runs `kernel` with baseline instructions: `f64` is the precision of references, and every copy costs build time.
#[inline(never)]
pub(super) fn dispatch_f64<K: Kernel<f64>>(kernel: K) -> K::Output {
    kernel.run(Scalar512b)
}

/// Runs `f`, compiled for AVX2 too; for loops that the compiler vectorises by itself.
/// `f` must be `#[inline(always)]`, and must not contain closures that the compiler does not inline.
#[inline(always)]
pub(crate) fn vectorized<R>(f: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if let Some(s) = pulp::x86::V3::try_new() {
        return s.vectorize(f);
    }
    f()
}

/// Whether the instructions of [`vectorized`] have fused multiply-add.
#[inline(always)]
pub(crate) fn has_fma() -> bool {
    #[cfg(target_arch = "x86_64")]
    return pulp::x86::V3::try_new().is_some();
    #[cfg(not(target_arch = "x86_64"))]
    return cfg!(target_arch = "aarch64");
}

/// Prefetches the first and the last byte of `value` where the hardware can.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let first: *const i8 = std::ptr::from_ref(value).cast();
        // SAFETY: SSE is part of x86-64, and a prefetch of any address has no effect that a program can see.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(first);
            _mm_prefetch::<_MM_HINT_T0>(first.wrapping_add(size_of::<T>().saturating_sub(1)));
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

/// Declares `fn $name`, which runs `$body::<E, FMA>` in [`vectorized`]; `FMA` says whether the hardware has fused
/// multiply-add. `$body` must be `#[inline(always)]`.
macro_rules! wide_kernel {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? => $body:ident) => {
        $(#[$meta])*
        $visibility fn $name<E: Real>($($arg: $type),*) $(-> $out)? {
            if !$crate::backend::simd::has_fma() {
                return $body::<E, false>($($arg),*);
            }
            $crate::backend::simd::vectorized(
                #[inline(always)]
                || $body::<E, true>($($arg),*),
            )
        }
    };
}
pub(crate) use wide_kernel;

/// `a b + c`, in one rounding where the kernel is compiled for it.
#[inline(always)]
pub(crate) fn multiply_add<E: Real, const FMA: bool>(a: E, b: E, c: E) -> E {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
