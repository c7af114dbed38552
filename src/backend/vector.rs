//! Vectors of lanes for kernels written once. `f32` on AVX2 uses intrinsics (the compiler's own vectoriser gives up on
//! chains as long as an exponential); everything else is plain loops over lanes, which it handles well enough.

use super::Real;

/// Numbers handled together.
pub const LANES: usize = 8;

/// For every set of lanes its members in order, and then zeros.
pub(crate) static MEMBERS: [[u8; LANES]; 1 << LANES] = {
    let mut members = [[0; LANES]; 1 << LANES];
    let mut set = 0;
    while set < members.len() {
        let (mut lane, mut count) = (0, 0);
        while lane < LANES {
            if set >> lane & 1 == 1 {
                members[set][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    members
};

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
    /// The smaller; `b` where either is NaN.
    fn min(self, b: Self) -> Self;
    /// The larger; `b` where either is NaN.
    fn max(self, b: Self) -> Self;
    /// `-|self|`.
    fn minus_abs(self) -> Self;
    /// `yes` where `self > b`, else `no`.
    fn select_above(self, b: Self, yes: Self, no: Self) -> Self;
    /// Bit `l` is set where lane `l` of `self` is above that of `b`.
    fn bits_above(self, b: Self) -> u32;
    /// `self` where `a > b`, else 0.
    fn keep_above(self, a: Self, b: Self) -> Self;
    /// `self` where it is at least `low`, else 0.
    fn keep_from(self, low: Self) -> Self;
    /// [`Real::exp2_nonpositive`].
    fn exp2_nonpositive(self) -> Self;
    /// Lane `from[l]` in lane `l`.
    fn permute(self, from: &[u8; LANES]) -> Self;
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
    fn max(self, b: Self) -> Self {
        self.zip(b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn minus_abs(self) -> Self {
        self.zip(self, |a, _| -a.abs())
    }
    #[inline(always)]
    fn select_above(self, b: Self, yes: Self, no: Self) -> Self {
        let mut out = no;
        for l in 0..LANES {
            out.0[l] = if self.0[l] > b.0[l] {
                yes.0[l]
            } else {
                no.0[l]
            };
        }
        out
    }
    #[inline(always)]
    fn bits_above(self, b: Self) -> u32 {
        let mut bits = 0;
        for l in 0..LANES {
            bits |= u32::from(self.0[l] > b.0[l]) << l;
        }
        bits
    }
    #[inline(always)]
    fn keep_above(self, a: Self, b: Self) -> Self {
        a.select_above(b, self, Self([E::zero(); LANES]))
    }
    #[inline(always)]
    fn keep_from(self, low: Self) -> Self {
        self.zip(low, |a, low| if a >= low { a } else { E::zero() })
    }
    #[inline(always)]
    fn exp2_nonpositive(self) -> Self {
        self.zip(self, |a, _| a.exp2_nonpositive::<FUSED>())
    }
    #[inline(always)]
    fn permute(self, from: &[u8; LANES]) -> Self {
        Self(from.map(|l| self.0[l as usize % LANES]))
    }
    #[inline(always)]
    fn total(self) -> E {
        let v = self.0;
        let half = |i: usize| v[i] + v[i + 4];
        (half(0) + half(2)) + (half(1) + half(3))
    }
}
