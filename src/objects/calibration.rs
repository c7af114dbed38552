//! Correction of pooled votes for systematic errors of the labels, fitted without truth.
//!
//! A vote averages independent errors away. It believes errors that repeat: a network names a frequent class such as wall wherever
//! it is unsure. Two corrections of the class shares of superpoints follow each other.
//!
//! 1. Shares are divided by prior^e, where the prior of a class is its mean share over the scene (logit adjustment, Menon et al.
//!    2021).
//! 2. Shares become likelihoods under a confusion matrix theta, whose row y holds how often superpoints of class y are labelled
//!    c (Dawid and Skene 1979, with superpoints as items and their winning class instead of a soft assignment). A superpoint of
//!    shares s has the probabilities p_y ~ prod_c theta_yc^s_c.

use super::PooledVotes;
use crate::data::winner;

/// Weight of the confusion matrix without preferred pairs, in shares of the scene.
const SHRINKAGE: f64 = 0.03;
/// Share of errors added to each row of the confusion matrix.
const SMOOTHING: f64 = 0.1;
/// Share below which a class counts as absent from a superpoint.
const MIN_SHARE: f64 = 1e-6;

/// What the votes of a scene say about its labels.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// prior^-e of each class, `[C]`.
    factors: Vec<f64>,
    /// ln theta, `[C, C]`: true class, then label. Rows of classes that win nowhere are negative infinity. Empty where shares are
    /// not corrected by it.
    log_confusion: Vec<f64>,
}

impl Calibration {
    /// Fits the calibration to `votes`, with class frequencies to the power of `exponent`, and with the second correction if
    /// `confusion` says so.
    pub fn fit(votes: &PooledVotes, exponent: f64, confusion: bool) -> Self {
        let prior = prior(votes);
        let factor = |prior: &f64| prior.max(MIN_SHARE).powf(-exponent);
        let factors: Vec<f64> = prior.iter().map(factor).collect();
        let log_confusion = if confusion {
            log_confusion(votes, &factors)
        } else {
            Vec::new()
        };
        Self {
            factors,
            log_confusion,
        }
    }

    /// Turns the class shares `row`, `[C]`, of any sum, into class probabilities. Zeros stay zeros.
    pub fn apply(&self, row: &mut [f64]) {
        divide(row, &self.factors);
        // Most shares are zero.
        let shown: Vec<(usize, f64)> = (0..)
            .zip(row.iter().copied())
            .filter(|(_, share)| *share > MIN_SHARE)
            .collect();
        if shown.is_empty() || !self.log_confusion.iter().any(|l| l.is_finite()) {
            return;
        }
        for (p, log) in row
            .iter_mut()
            .zip(self.log_confusion.chunks_exact(self.factors.len()))
        {
            *p = shown.iter().map(|&(c, share)| share * log[c]).sum();
        }
        let highest = row.iter().fold(f64::NEG_INFINITY, |h, &l| h.max(l));
        row.iter_mut().for_each(|p| *p = (*p - highest).exp());
        normalise(row);
    }
}

/// ln theta of `votes`, after their multiplication by `factors`.
fn log_confusion(votes: &PooledVotes, factors: &[f64]) -> Vec<f64> {
    let mut flux = Flux::new(votes.classes);
    for (row, size) in votes.rows() {
        let mut row = row.to_vec();
        divide(&mut row, factors);
        flux.add(&row, size);
    }
    flux.log_confusion()
}

/// Multiplies `row` by `factors` and brings its sum to 1.
fn divide(row: &mut [f64], factors: &[f64]) {
    row.iter_mut().zip(factors).for_each(|(s, f)| *s *= f);
    normalise(row);
}

/// Mean share of each class over all Gaussians with votes.
fn prior(votes: &PooledVotes) -> Vec<f64> {
    let mut prior = vec![0.0; votes.classes];
    for (row, size) in votes.rows() {
        prior.iter_mut().zip(row).for_each(|(p, s)| *p += size * s);
    }
    normalise(&mut prior);
    prior
}

pub(super) fn normalise(row: &mut [f64]) {
    let sum: f64 = row.iter().sum();
    if sum > 0.0 {
        row.iter_mut().for_each(|value| *value /= sum);
    }
}

/// How much of the scene has which label, by winning class: `[C, C]` row-major, winner, then label.
pub(super) struct Flux {
    classes: usize,
    table: Vec<f64>,
}

impl Flux {
    pub(super) fn new(classes: usize) -> Self {
        Self {
            classes,
            table: vec![0.0; classes * classes],
        }
    }

    /// Adds a piece of surface with the class shares `row`.
    pub(super) fn add(&mut self, row: &[f64], size: f64) {
        if let Some(winner) = winner(row) {
            let to = &mut self.table[winner * self.classes..][..self.classes];
            to.iter_mut().zip(row).for_each(|(t, s)| *t += size * s);
        }
    }

    pub(super) fn at(&self, winner: usize, label: usize) -> f64 {
        self.table[winner * self.classes + label]
    }

    /// What each class wins, `[C]`.
    pub(super) fn won(&self) -> Vec<f64> {
        let rows = self.table.chunks_exact(self.classes.max(1));
        rows.map(|row| row.iter().sum()).collect()
    }

    /// ln theta. Rows are shrunk towards a matrix where all classes are labelled right equally often and errors name each class as
    /// often as it is named elsewhere.
    fn log_confusion(&self) -> Vec<f64> {
        let classes = self.classes;
        let won = self.won();
        let total: f64 = won.iter().sum();
        let right: f64 = (0..classes).map(|c| self.at(c, c)).sum();
        let right = right / total.max(MIN_SHARE);
        let wrong = |c: usize| {
            let named: f64 = (0..classes).map(|y| self.at(y, c)).sum();
            (named - self.at(c, c) + MIN_SHARE * total) / (total - won[c]).max(MIN_SHARE * total)
        };
        let mut errors: Vec<f64> = (0..classes).map(wrong).collect();
        normalise(&mut errors);
        let row = |y: usize| {
            let mut typical: Vec<f64> = errors.iter().map(|e| (1.0 - right) * e).collect();
            typical[y] += right;
            normalise(&mut typical);
            let add = |(c, t): (usize, f64)| self.at(y, c) + SHRINKAGE * total * t;
            let mut row: Vec<f64> = typical.into_iter().enumerate().map(add).collect();
            normalise(&mut row);
            let smooth = |(p, e): (&mut f64, &f64)| *p += SMOOTHING * e + MIN_SHARE;
            row.iter_mut().zip(&errors).for_each(smooth);
            normalise(&mut row);
            row.into_iter().map(f64::ln).collect::<Vec<_>>()
        };
        let rows = (0..classes).map(|y| {
            if won[y] > 0.0 {
                row(y)
            } else {
                vec![f64::NEG_INFINITY; classes]
            }
        });
        rows.flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Superpoints of each class, from a frequent one to a rare one.
    const COUNTS: [usize; 5] = [400, 150, 60, 25, 10];

    /// Votes of superpoints of true classes `truth`, whose labels name class c instead with the weight `wrong(truth, c)`, times a
    /// random factor that differs between superpoints.
    fn votes(wrong: impl Fn(usize, usize) -> f64) -> (PooledVotes, Vec<usize>) {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let classes = COUNTS.len();
        let truth: Vec<usize> = (0..classes).flat_map(|c| vec![c; COUNTS[c]]).collect();
        let mut shares = Vec::new();
        for &y in &truth {
            let factor = rng.random_range(0.0..2.0);
            let weight = |c: usize| if c == y { 1.0 } else { factor * wrong(y, c) };
            let mut row: Vec<f64> = (0..classes).map(weight).collect();
            normalise(&mut row);
            shares.extend(row);
        }
        let sizes = (0..truth.len()).map(|_| rng.random_range(20.0..200.0));
        let sizes = sizes.collect();
        let votes = PooledVotes {
            shares,
            sizes,
            classes,
        };
        (votes, truth)
    }

    /// The calibrated rows of `votes`.
    fn applied(calibration: &Calibration, votes: &PooledVotes) -> Vec<f64> {
        let mut rows = votes.shares.clone();
        let each = rows.chunks_exact_mut(COUNTS.len());
        each.for_each(|row| calibration.apply(row));
        rows
    }

    fn right(rows: &[f64], truth: &[usize]) -> usize {
        let winners = rows.chunks_exact(COUNTS.len()).map(winner);
        let pairs = winners.zip(truth);
        pairs.filter(|(w, t)| *w == Some(**t)).count()
    }

    #[test]
    fn a_class_that_is_named_too_often_gives_way() {
        // All are taken for the frequent class, often by most of their labels.
        let (votes, truth) = votes(|_, c| if c == 0 { 1.0 } else { 0.01 });
        let calibration = Calibration::fit(&votes, 0.5, true);
        let voted = right(&votes.shares, &truth);
        let calibrated = right(&applied(&calibration, &votes), &truth);
        assert!(
            voted < truth.len() * 85 / 100 && calibrated > truth.len() * 95 / 100,
            "{voted}, then {calibrated} of {}",
            truth.len()
        );
    }

    #[test]
    fn probabilities_sum_to_one_and_nothing_stays_nothing() {
        let (mut votes, _) = votes(|_, c| 0.1 * c as f64);
        votes.shares[..COUNTS.len()].fill(0.0);
        votes.sizes[0] = 0.0;
        let calibration = Calibration::fit(&votes, 0.25, true);
        let rows = applied(&calibration, &votes);
        let sums: Vec<f64> = rows
            .chunks_exact(COUNTS.len())
            .map(|r| r.iter().sum())
            .collect();
        assert_eq!(sums[0], 0.0);
        assert!(sums[1..].iter().all(|sum| (sum - 1.0).abs() < 1e-12));
        let none = PooledVotes {
            shares: Vec::new(),
            sizes: Vec::new(),
            classes: 3,
        };
        let mut row = [1.0, 0.0, 0.0];
        Calibration::fit(&none, 0.5, true).apply(&mut row);
        assert!(row.iter().all(|p| !p.is_nan()), "{row:?}");
    }

    #[test]
    fn without_the_confusion_matrix_shares_are_divided_by_their_frequencies() {
        let (votes, _) = votes(|_, c| if c == 0 { 1.0 } else { 0.01 });
        let calibration = Calibration::fit(&votes, 1.0, false);
        // Frequencies themselves become the same for each class.
        let mut row = prior(&votes);
        calibration.apply(&mut row);
        assert!(row.iter().all(|p| (p - 0.2).abs() < 1e-12), "{row:?}");
    }

    #[test]
    fn a_class_that_wins_nowhere_gets_no_probability() {
        let (votes, _) = votes(|_, c| if c == 1 { 0.02 } else { 0.0 });
        let mut shares = votes.shares.clone();
        for row in shares.chunks_exact_mut(COUNTS.len()) {
            row[4] = row[4].min(0.3);
            row[0] += 0.7;
            normalise(row);
        }
        let votes = PooledVotes { shares, ..votes };
        let rows = applied(&Calibration::fit(&votes, 0.0, true), &votes);
        let rare = rows.chunks_exact(COUNTS.len()).map(|row| row[4]);
        assert!(rare.into_iter().all(|p| p == 0.0));
    }
}
