//! The two pointwise functions of a transformer, eight numbers at a time.

use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, Vector};

pub(super) const LOG2_E: f32 = std::f32::consts::LOG2_E;

/// Lower than any score: exponentials of it are 2^-125, nothing beside the 1 of the largest score.
const LOWEST: f32 = -1e30;

/// `2^(x - max x)` in place; returns their sum, which is at least 1.
pub(super) fn softmax_numerators(row: &mut [f32]) -> f32 {
    dispatch(Softmax { row })
}

/// The Gaussian error linear unit, `x Phi(x)` with the normal distribution's own Phi (not the tanh approximation), in place.
///
/// By Abramowitz and Stegun 7.1.26, whose erf is within 1.5e-7 of the true one: results are within 3e-7.
pub(super) fn gelu(values: &mut [f32]) {
    dispatch(Gelu { values });
}

/// Eights of `values`; the last, `tail`, is filled up with `filler` and has to be put back into `rest`.
struct Eights<'a> {
    whole: &'a mut [[f32; LANES]],
    tail: [f32; LANES],
    rest: &'a mut [f32],
}

impl<'a> Eights<'a> {
    #[inline(always)]
    fn of(values: &'a mut [f32], filler: f32) -> Self {
        let (whole, rest) = values.as_chunks_mut::<LANES>();
        let mut tail = [filler; LANES];
        tail[..rest.len()].copy_from_slice(rest);
        Self { whole, tail, rest }
    }

    /// For loops, not closures: a closure that is not inlined would lose the wider instructions.
    #[inline(always)]
    fn iter_mut(&mut self) -> impl Iterator<Item = &mut [f32; LANES]> {
        self.whole.iter_mut().chain(std::iter::once(&mut self.tail))
    }

    #[inline(always)]
    fn put_back(self) {
        self.rest.copy_from_slice(&self.tail[..self.rest.len()]);
    }
}

struct Softmax<'a> {
    row: &'a mut [f32],
}

impl Kernel<f32> for Softmax<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<V: Vector<f32>>(self) -> f32 {
        let mut row = Eights::of(self.row, LOWEST);
        let mut largest = V::splat(LOWEST);
        for x in row.iter_mut() {
            largest = largest.max(V::load(x));
        }
        let mut lanes = [0.0; LANES];
        largest.store(&mut lanes);
        let largest = V::splat(lanes.iter().fold(LOWEST, |a, &b| a.max(b)));
        let mut sum = V::splat(0.0);
        for x in row.iter_mut() {
            let power = V::load(x).sub(largest).exp2_nonpositive();
            sum = sum.add(power);
            power.store(x);
        }
        row.put_back();
        sum.total()
    }
}

struct Gelu<'a> {
    values: &'a mut [f32],
}

impl Kernel<f32> for Gelu<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector<f32>>(self) {
        // Of t = 1 / (1 + p z) at z = |x| / sqrt 2, and the coefficients of its powers, highest first.
        const P: f32 = 0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2;
        const HIGHEST: f32 = 1.061_405_4;
        const OTHERS: [f32; 4] = [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6];
        let (one, zero) = (V::splat(1.0), V::splat(0.0));
        let mut values = Eights::of(self.values, 0.0);
        for at in values.iter_mut() {
            let x = V::load(at);
            let minus = x.minus_abs();
            let t = one.div(minus.fnma(V::splat(P), one));
            let mut series = V::splat(HIGHEST);
            for c in OTHERS {
                series = series.fma(t, V::splat(c));
            }
            let power = minus
                .mul(zero.sub(minus))
                .mul(V::splat(0.5 * LOG2_E))
                .exp2_nonpositive();
            // erfc z = t series exp(-z^2), and x Phi(x) = max(x, 0) - |x| erfc(z) / 2.
            let erfc = t.mul(series).mul(power);
            minus.mul(V::splat(0.5)).fma(erfc, x.max(zero)).store(at);
        }
        values.put_back();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// erf by its Taylor series, good to 1e-9 below 4.
    fn erf(x: f64) -> f64 {
        let (mut term, mut sum) = (x, x);
        for n in 1..120 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        sum * std::f64::consts::FRAC_2_SQRT_PI
    }

    #[test]
    fn gelu_is_the_exact_one() {
        let mut values: Vec<f32> = (-500..=500).map(|i| i as f32 * 0.01).collect();
        values.extend([1e4, -1e4, 1e20, -1e20, 0.0]);
        let inputs = values.clone();
        gelu(&mut values);
        for (&x, &y) in inputs.iter().zip(&values) {
            let x = f64::from(x);
            let expected = match x {
                x if x > 6.0 => x,
                x if x < -6.0 => 0.0,
                x => 0.5 * x * (1.0 + erf(x / 2.0_f64.sqrt())),
            };
            assert!(
                (f64::from(y) - expected).abs() <= 4e-7 * x.abs().max(1.0),
                "{x}: {y}, {expected}"
            );
        }
    }

    #[test]
    fn softmax_sums_at_any_length() {
        for n in [1, 7, 8, 9, 31] {
            let scores: Vec<f32> = (0..n)
                .map(|i| (i as f32 * 1.7).sin() * 20.0 + 300.0)
                .collect();
            let mut row = scores.clone();
            let sum = softmax_numerators(&mut row);
            let peak = scores.iter().fold(f32::MIN, |a, &b| a.max(b));
            let exact: Vec<f64> = scores.iter().map(|&s| f64::from(s - peak).exp2()).collect();
            assert!((f64::from(sum) - exact.iter().sum::<f64>()).abs() < 1e-5 * f64::from(sum));
            assert!(
                row.iter()
                    .zip(&exact)
                    .all(|(&a, b)| (f64::from(a) - b).abs() < 1e-6)
            );
        }
    }
}
