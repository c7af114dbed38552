//! Operations on registers of `f32` that `pulp` has no common name for, or no fast one.

use pulp::{Scalar512b, Simd};

/// What [`super::Lanes`] needs of an instruction set, besides what `pulp` has.
pub trait Operations: Simd {
    /// Bit `l` is set where lane `l` is true.
    fn mask_bits(self, mask: Self::m32s) -> u32;
    /// The lanes whose bit is set, in order.
    fn compress_f32s(self, x: Self::f32s, bits: u32) -> Self::f32s;

    /// `x` where `mask`, else 0.
    #[inline(always)]
    fn keep_f32s(self, mask: Self::m32s, x: Self::f32s) -> Self::f32s {
        self.select_f32s(mask, x, self.splat_f32s(0.0))
    }

    /// The sums of all lanes of each register.
    #[inline(always)]
    fn totals_f32s(self, a: [Self::f32s; 8]) -> [f32; 8] {
        a.map(|a| self.reduce_sum_f32s(a))
    }
}

#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
impl Operations for pulp::x86::V4 {
    #[inline(always)]
    fn mask_bits(self, mask: Self::m32s) -> u32 {
        u32::from(mask.0)
    }

    #[inline(always)]
    fn compress_f32s(self, x: Self::f32s, bits: u32) -> Self::f32s {
        pulp::cast(
            self.avx512f
                ._mm512_maskz_compress_ps(bits as u16, pulp::cast(x)),
        )
    }

    /// Halves are added, then as with half the lanes; the additions are those of `reduce_sum_f32s`.
    #[inline(always)]
    fn totals_f32s(self, a: [Self::f32s; 8]) -> [f32; 8] {
        let halves = a.map(|a| {
            let [low, high] = pulp::cast::<_, [std::arch::x86_64::__m256; 2]>(a);
            pulp::cast(self.avx._mm256_add_ps(low, high))
        });
        (*self).totals_f32s(halves)
    }
}

#[cfg(target_arch = "x86_64")]
impl Operations for pulp::x86::V3 {
    #[inline(always)]
    fn mask_bits(self, mask: Self::m32s) -> u32 {
        self.avx._mm256_movemask_ps(pulp::cast(mask)) as u32
    }

    #[inline(always)]
    fn compress_f32s(self, x: Self::f32s, bits: u32) -> Self::f32s {
        let from = pulp::cast(places(bits).map(i32::from));
        let permuted = (self.avx2)._mm256_permutevar8x32_ps(pulp::cast(x), from);
        pulp::cast(permuted)
    }

    // A blend takes twice the operations of an `and` on some processors.
    #[inline(always)]
    fn keep_f32s(self, mask: Self::m32s, x: Self::f32s) -> Self::f32s {
        pulp::cast(self.avx._mm256_and_ps(pulp::cast(mask), pulp::cast(x)))
    }

    /// Halves are added, then halves of halves, for two, four and eight registers at once; the additions are those of
    /// `reduce_sum_f32s`.
    #[inline(always)]
    fn totals_f32s(self, a: [Self::f32s; 8]) -> [f32; 8] {
        let avx = self.avx;
        let [a, b, c, d, e, f, g, h] = pulp::cast::<_, [std::arch::x86_64::__m256; 8]>(a);
        let halves = |a, b| {
            avx._mm256_add_ps(
                avx._mm256_permute2f128_ps::<0x20>(a, b),
                avx._mm256_permute2f128_ps::<0x31>(a, b),
            )
        };
        let quarters = |a, b| {
            avx._mm256_add_ps(
                avx._mm256_shuffle_ps::<0x44>(a, b),
                avx._mm256_shuffle_ps::<0xee>(a, b),
            )
        };
        let abef = quarters(halves(a, e), halves(b, f));
        let cdgh = quarters(halves(c, g), halves(d, h));
        pulp::cast(avx._mm256_add_ps(
            avx._mm256_shuffle_ps::<0x88>(abef, cdgh),
            avx._mm256_shuffle_ps::<0xdd>(abef, cdgh),
        ))
    }
}

#[cfg(target_arch = "aarch64")]
impl Operations for pulp::aarch64::Neon {
    #[inline(always)]
    fn mask_bits(self, mask: Self::m32s) -> u32 {
        sign_bits(pulp::cast::<_, [i32; 4]>(mask))
    }

    #[inline(always)]
    fn compress_f32s(self, x: Self::f32s, bits: u32) -> Self::f32s {
        pulp::cast(compressed::<f32, 4>(pulp::cast(x), bits))
    }
}

impl Operations for Scalar512b {
    #[inline(always)]
    fn mask_bits(self, mask: Self::m32s) -> u32 {
        sign_bits(pulp::cast::<_, [i32; 16]>(mask))
    }

    #[inline(always)]
    fn compress_f32s(self, x: Self::f32s, bits: u32) -> Self::f32s {
        pulp::cast(compressed::<f32, 16>(pulp::cast(x), bits))
    }
}

/// Bit `l` is set where lane `l` is negative: lanes of a mask are 0 or -1.
#[inline(always)]
pub(super) fn sign_bits<const L: usize>(lanes: [i32; L]) -> u32 {
    (0..L).fold(0, |bits, l| bits | u32::from(lanes[l] < 0) << l)
}

/// The numbers whose bit is set, in order.
#[inline(always)]
pub(super) fn compressed<E: Copy, const L: usize>(lanes: [E; L], bits: u32) -> [E; L] {
    let mut out = lanes;
    let mut count = 0;
    for (l, &lane) in lanes.iter().enumerate() {
        // Written over by the next one unless its bit is set.
        out[count % L] = lane;
        count += (bits >> l & 1) as usize;
    }
    out
}

/// Which of the low eight bits are set, in order, and then zeros.
#[inline(always)]
pub(crate) fn places(bits: u32) -> [u8; 8] {
    PLACES[bits as usize % PLACES.len()]
}

static PLACES: [[u8; 8]; 256] = {
    let mut places = [[0; 8]; 256];
    let mut bits = 0;
    while bits < places.len() {
        let mut place = 0;
        let mut count = 0;
        while place < 8 {
            if bits >> place & 1 == 1 {
                places[bits][count] = place;
                count += 1;
            }
            place += 1;
        }
        bits += 1;
    }
    places
};

#[cfg(test)]
mod tests {
    use crate::backend::simd::{Kernel, Lanes, dispatch_f32};

    /// Whether the fast operations give the bits of the plain ones.
    struct Compare([f32; 128]);

    impl Kernel<f32> for Compare {
        type Output = ();

        fn run<S: Lanes<f32>>(self, s: S) {
            let registers = S::registers(&self.0);
            let eight: [S::V; 8] = std::array::from_fn(|i| registers[i % registers.len()]);
            let bits = |sums: [f32; 8]| sums.map(f32::to_bits);
            assert_eq!(
                bits(s.totals(eight)),
                bits(eight.map(|register| s.total(register)))
            );
            let mut written = [0.0; 11];
            let eleven: Vec<S::V> = eight.into_iter().cycle().take(11).collect();
            s.write_totals(&eleven, &mut written);
            for (register, sum) in eleven.into_iter().zip(written) {
                assert_eq!(s.total(register).to_bits(), sum.to_bits());
            }
            for pair in eight.windows(2) {
                let mask = s.greater(pair[0], pair[1]);
                let kept = s.keep(mask, pair[0]);
                let selected = s.select(mask, pair[0], s.splat(0.0));
                assert_eq!(s.bits(s.greater(kept, selected)), 0);
                assert_eq!(s.bits(s.greater(selected, kept)), 0);
            }
        }
    }

    #[test]
    fn fast_operations_are_the_plain_ones() {
        let values = std::array::from_fn(|i| ((i * 37 % 128) as f32 - 60.0) * 1.37e-3);
        dispatch_f32(Compare(values));
        Compare(values).run(pulp::Scalar512b);
    }
}
