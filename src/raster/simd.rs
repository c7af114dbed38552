//! One kernel source, compiled for several instruction sets, chosen at run time.
//!
//! A kernel is a [`Kernel`] whose `run` is `#[inline(always)]`: it is inlined into a function with wider instructions
//! enabled and vectorised there. Baseline x86-64 costs about four times as much.

/// Work to be compiled once per instruction set. `FUSED`: multiply and add with one rounding.
pub(super) trait Kernel {
    type Output;
    fn run<const FUSED: bool>(self) -> Self::Output;
}

/// Runs `kernel` with the widest instructions that this processor has.
#[cfg(target_arch = "x86_64")]
pub(super) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has the features, checked above.
        return unsafe { with_avx512(kernel) };
    }
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has the features, checked above.
        return unsafe { with_avx2(kernel) };
    }
    kernel.run::<false>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
fn with_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

/// Runs `kernel`; aarch64 has 128-bit vectors with fused multiply-add in its baseline.
#[cfg(not(target_arch = "x86_64"))]
pub(super) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<{ cfg!(target_arch = "aarch64") }>()
}
