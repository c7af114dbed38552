//! Repeated measurements of one quantity.

use crate::error::Result;
use std::time::Instant;

/// Values of one quantity; seconds unless [`Samples::scaled`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples(Vec<f64>);

impl Samples {
    /// Seconds of each of `repeats` runs of `work` (at least one), after one run that is not counted.
    ///
    /// # Errors
    /// The first that `work` returns.
    pub fn of(repeats: usize, mut work: impl FnMut() -> Result<()>) -> Result<Self> {
        work()?;
        let mut samples = Self::default();
        for _ in 0..repeats.max(1) {
            samples.time(&mut work)?;
        }
        Ok(samples)
    }

    /// Adds the seconds of one run of `work` and returns its result.
    ///
    /// # Errors
    /// That of `work`; nothing is added then.
    pub fn time<T>(&mut self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let start = Instant::now();
        let out = work()?;
        self.0.push(start.elapsed().as_secs_f64());
        Ok(out)
    }

    /// Adds a value.
    pub fn push(&mut self, value: f64) {
        self.0.push(value);
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The middle value, or the mean of the middle two; 0 without samples.
    pub fn median(&self) -> f64 {
        let mut sorted = self.0.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        match (sorted.get(sorted.len() / 2), sorted.len() % 2) {
            (None, _) => 0.0,
            (Some(&middle), 1) => middle,
            (Some(&above), _) => (sorted[sorted.len() / 2 - 1] + above) / 2.0,
        }
    }

    /// The smallest and the largest value; zeros without samples.
    pub fn spread(&self) -> [f64; 2] {
        let fold = |f: fn(f64, f64) -> f64| self.0.iter().copied().reduce(f).unwrap_or(0.0);
        [fold(f64::min), fold(f64::max)]
    }

    /// Sum of all values.
    pub fn sum(&self) -> f64 {
        self.0.iter().sum()
    }

    /// Every value times `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self(self.0.iter().map(|v| v * factor).collect())
    }
}

impl FromIterator<f64> for Samples {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_spread() {
        let odd: Samples = [5.0, 1.0, 3.0].into_iter().collect();
        assert_eq!(
            (odd.median(), odd.spread(), odd.len()),
            (3.0, [1.0, 5.0], 3)
        );
        let even: Samples = [4.0, 1.0, 2.0, 100.0].into_iter().collect();
        assert_eq!((even.median(), even.scaled(2.0).median()), (3.0, 6.0));
        assert_eq!(
            (Samples::default().median(), Samples::default().spread()),
            (0.0, [0.0, 0.0])
        );
    }

    #[test]
    fn the_first_run_is_not_counted() {
        let mut runs = 0;
        let samples = Samples::of(3, || {
            runs += 1;
            Ok(())
        });
        assert_eq!((samples.map(|s| s.len()).ok(), runs), (Some(3), 4));
    }
}
