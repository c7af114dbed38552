//! Run-time choice of instruction set for kernels written once.
//!
//! `f32` kernels are compiled twice on x86-64, for the build's baseline and for AVX2 with FMA, which is several times
//! as fast. `f64`, the precision of references, has the baseline copy only: every copy costs
//! build time.

use super::Real;
use super::vector::{Plain, Vector};

/// Work over vectors. `run` must be `#[inline(always)]`, so that it lands in a function with wider instructions enabled.
pub(crate) trait Kernel<E> {
    type Output;
    fn run<V: Vector<E>>(self) -> Self::Output;
}

/// Runs `kernel` with the widest instructions that it is compiled for and this processor has.
pub(crate) fn dispatch<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if const { E::WIDE } {
        #[target_feature(enable = "avx2,fma")]
        fn wide<E: Real, K: Kernel<E>>(kernel: K) -> K::Output {
            kernel.run::<E::Wide>()
        }
        if wide_instructions() {
            // SAFETY: the processor has both, checked just now.
            return unsafe { wide(kernel) };
        }
    }
    // Fused multiply-add is part of aarch64.
    kernel.run::<Plain<E, { cfg!(target_arch = "aarch64") }>>()
}

/// Whether the processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(crate) fn wide_instructions() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// Asks for the memory of `value`, its first and its last byte, to be brought near, where the hardware can be asked.
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

/// Declares `fn $name`, which runs `$body::<E, FMA>`: [`dispatch`] for loops that the compiler vectorises by itself.
/// `$body` must be `#[inline(always)]`, and closures that it does not inline lose the wider instructions.
macro_rules! wide_kernel {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? => $body:ident) => {
        $(#[$meta])*
        $visibility fn $name<E: Real>($($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            if const { E::WIDE } {
                #[target_feature(enable = "avx2,fma")]
                fn wide<E: Real>($($arg: $type),*) $(-> $out)? {
                    $body::<E, true>($($arg),*)
                }
                if $crate::backend::simd::wide_instructions() {
                    // SAFETY: the processor has both, checked just now.
                    return unsafe { wide::<E>($($arg),*) };
                }
            }
            $body::<E, false>($($arg),*)
        }
    };
}
pub(crate) use wide_kernel;

/// [`wide_kernel`] for a body that works in `f64` whatever the kernels' type: compiled twice, used by both.
macro_rules! wide_function {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? => $body:ident) => {
        $(#[$meta])*
        $visibility fn $name($($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma")]
                fn wide($($arg: $type),*) $(-> $out)? {
                    $body($($arg),*)
                }
                if $crate::backend::simd::wide_instructions() {
                    // SAFETY: the processor has both, checked just now.
                    return unsafe { wide($($arg),*) };
                }
            }
            $body($($arg),*)
        }
    };
}
pub(crate) use wide_function;

/// `a b + c`, in one rounding where the kernel is compiled for it.
#[inline(always)]
pub(crate) fn multiply_add<E: Real, const FMA: bool>(a: E, b: E, c: E) -> E {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
