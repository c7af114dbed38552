//! Exponential and logarithm in `f64` without branches or calls, so that loops over many values become vectors. No fused
//! operations: the same bits with any instruction set.

/// `ln 2` in two parts, the first with enough trailing zeros that its multiples by exponents are exact.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// Adding 1.5 2^52 rounds to an integer and leaves it in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// Below the first the result is 0, above the second infinite: all powers of 2 in between are normal numbers.
const RANGE: [f64; 2] = [-708.0, 709.4];
/// Taylor coefficients of `e^r` for `|r| <= ln 2 / 2`, highest power first: the first one left out is below 6e-18 of the sum.
const EXP: [f64; 14] = {
    let mut c = [1.0; 14];
    let mut power = 1;
    while power < c.len() {
        c[c.len() - 1 - power] = c[c.len() - power] / power as f64;
        power += 1;
    }
    c
};
/// `artanh(s) / s` in powers of `s^2 <= 1 / 9`, highest power first.
const ARTANH: [f64; 17] = {
    let mut c = [1.0; 17];
    let mut power = 0;
    while power < c.len() {
        c[c.len() - 1 - power] = 1.0 / (2 * power + 1) as f64;
        power += 1;
    }
    c
};

#[inline(always)]
fn polynomial<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    let mut sum = coefficients[0];
    for &c in &coefficients[1..] {
        sum = sum * x + c;
    }
    sum
}

/// `e^x`: relative error below 3e-16 for `-708 <= x <= 709.4`; 0 below that, infinite above. NaN stays NaN.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    let inside = x.clamp(RANGE[0], RANGE[1]);
    let shifted = inside * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (inside - n * LN_2[0]) - n * LN_2[1];
    let p = polynomial(&EXP, r);
    let e = f64::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 52));
    let e = if x < RANGE[0] { 0.0 } else { e };
    let e = if x > RANGE[1] { f64::INFINITY } else { e };
    if x.is_nan() { x } else { e }
}

/// The largest integer that is not above `x`, for `|x| < 2^51`.
#[inline(always)]
pub(crate) fn floor(x: f64) -> f64 {
    let nearest = (x + ROUND) - ROUND;
    if nearest > x { nearest - 1.0 } else { nearest }
}

/// `ln(1 + x)` for `0 <= x <= 1`, relative error below 5e-16.
#[inline(always)]
pub(crate) fn ln_1p_unit(x: f64) -> f64 {
    let s = x / (2.0 + x);
    2.0 * s * polynomial(&ARTANH, s * s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(from: f64, to: f64, ours: impl Fn(f64) -> f64, exact: impl Fn(f64) -> f64) -> f64 {
        let steps = 400_000;
        let error = |i: i32| {
            let x = from + (to - from) * f64::from(i) / f64::from(steps);
            (ours(x) - exact(x)).abs() / exact(x).abs().max(f64::MIN_POSITIVE)
        };
        (0..=steps).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn exponential_agrees_with_the_library() {
        for (from, to) in [(-708.0, 709.3), (-40.0, 10.0), (-1.0, 1.0), (-1e-9, 1e-9)] {
            assert!(worst(from, to, exp, f64::exp) < 3e-16, "{from} to {to}");
        }
    }

    #[test]
    fn exponential_outside_its_range() {
        assert_eq!([-708.1, -1e300, f64::NEG_INFINITY].map(exp), [0.0; 3]);
        assert_eq!([709.5, 1e300, f64::INFINITY].map(exp), [f64::INFINITY; 3]);
        assert!(exp(f64::NAN).is_nan());
        assert_eq!(exp(0.0), 1.0);
    }

    #[test]
    fn logarithm_agrees_with_the_library() {
        for (from, to) in [(0.0, 1.0), (0.0, 1e-6)] {
            assert!(
                worst(from, to, ln_1p_unit, f64::ln_1p) < 5e-16,
                "{from} to {to}"
            );
        }
    }
}
