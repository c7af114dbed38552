//! Run-time choice of instruction set for inner loops written once as plain Rust.

use super::Real;

/// Declares `fn $name`, which runs `$body::<E, FMA>` compiled for AVX2 with FMA where the CPU has them and for the
/// build's baseline otherwise. `$body` must be `#[inline(always)]`, and closures that it does not inline lose the wider
/// instructions.
macro_rules! wide_kernel {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? => $body:ident) => {
        $(#[$meta])*
        $visibility fn $name<E: Real>($($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
                #[target_feature(enable = "avx2,fma")]
                fn wide<E: Real>($($arg: $type),*) $(-> $out)? {
                    $body::<E, true>($($arg),*)
                }
                // SAFETY: the CPU has both, checked just now.
                return unsafe { wide::<E>($($arg),*) };
            }
            $body::<E, false>($($arg),*)
        }
    };
}
pub(crate) use wide_kernel;

/// `a b + c`, in one rounding where the kernel is compiled for it.
#[inline(always)]
pub(crate) fn multiply_add<E: Real, const FMA: bool>(a: E, b: E, c: E) -> E {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
