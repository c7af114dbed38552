//! The two pointwise functions of a transformer, a register of numbers at a time.

use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};

pub(super) const LOG2_E: f32 = std::f32::consts::LOG2_E;

/// Lower than any score: exponentials of it are 2^-125, nothing beside the 1 of the largest score.
const LOWEST: f32 = -1e30;

/// `2^(x - max x)` in place; returns their sum, which is at least 1.
pub(super) fn softmax_numerators(row: &mut [f32]) -> f32 {
    f32::dispatch(Softmax { row })
}

/// The Gaussian error linear unit, `x Phi(x)` with the normal distribution's own Phi (not the tanh approximation), in place.
///
/// By Abramowitz and Stegun 7.1.26, whose erf is within 1.5e-7 of the true one: results are within 3e-7.
pub(super) fn gelu(values: &mut [f32]) {
    f32::dispatch(Gelu { values });
}

/// Numbers of the widest register.
const WIDEST: usize = 16;

/// Registers of a slice. Its end, in `tail`, is filled up with a filler, and has to be put back into `rest`.
struct Registers<'a> {
    whole: &'a mut [f32],
    tail: [f32; WIDEST],
    rest: &'a mut [f32],
}

impl<'a> Registers<'a> {
    #[inline(always)]
    fn of(values: &'a mut [f32], filler: f32) -> Self {
        let (whole, rest) = values.split_at_mut(values.len() / WIDEST * WIDEST);
        let mut tail = [filler; WIDEST];
        tail[..rest.len()].copy_from_slice(rest);
        Self { whole, tail, rest }
    }

    /// For loops, not closures: a closure that is not inlined would lose the wider instructions.
    #[inline(always)]
    fn iter_mut<S: Lanes<f32>>(&mut self) -> impl Iterator<Item = &mut S::V> {
        S::registers_mut(self.whole)
            .iter_mut()
            .chain(S::registers_mut(&mut self.tail))
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
    fn run<S: Lanes<f32>>(self, s: S) -> f32 {
        let mut row = Registers::of(self.row, LOWEST);
        let mut largest = s.splat(LOWEST);
        for &mut x in row.iter_mut::<S>() {
            largest = s.max(largest, x);
        }
        let mut lanes = [LOWEST; WIDEST];
        S::registers_mut(&mut lanes)[0] = largest;
        let largest = s.splat(lanes.iter().fold(LOWEST, |a, &b| a.max(b)));
        let mut sum = s.splat(0.0);
        for x in row.iter_mut::<S>() {
            *x = s.exp2_nonpositive(s.sub(*x, largest));
            sum = s.add(sum, *x);
        }
        row.put_back();
        s.total(sum)
    }
}

struct Gelu<'a> {
    values: &'a mut [f32],
}

impl Kernel<f32> for Gelu<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<f32>>(self, s: S) {
        // Of t = 1 / (1 + p z) at z = |x| / sqrt 2, and the coefficients of its powers, highest first.
        const P: f32 = 0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2;
        const HIGHEST: f32 = 1.061_405_4;
        const OTHERS: [f32; 4] = [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6];
        let one = s.splat(1.0);
        let zero = s.splat(0.0);
        let mut values = Registers::of(self.values, 0.0);
        for x in values.iter_mut::<S>() {
            let minus = s.minus_abs(*x);
            let t = s.div(one, s.neg_mul_add(minus, s.splat(P), one));
            let mut series = s.splat(HIGHEST);
            for c in OTHERS {
                series = s.mul_add(series, t, s.splat(c));
            }
            let minus_square = s.mul(minus, s.sub(zero, minus));
            let power = s.exp2_nonpositive(s.mul(minus_square, s.splat(0.5 * LOG2_E)));
            // erfc z = t series exp(-z^2), and x Phi(x) = max(x, 0) - |x| erfc(z) / 2.
            let erfc = s.mul(s.mul(t, series), power);
            *x = s.mul_add(s.mul(minus, s.splat(0.5)), erfc, s.max(*x, zero));
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
