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
use super::largest::first_largest;

/// Exponent e of class frequencies, unless settings give another.
const EXPONENT: f64 = 0.5;
/// Preferences between which the exponent rises from 0 to all of it. Simulated labels of three rooms had 0.15 to 0.41,
/// those of a network 0.48 to 0.84.
const PREFERENCES: [f64; 2] = [0.43, 0.47];
/// Shares of errors between which pooling rises likewise. True labels of these rooms had 0.015 to 0.018, those of the network 0.07 to 0.12.
const ERROR_SHARES: [f64; 2] = [0.03, 0.06];
/// Share of both fluxes of a pair that is added to each, which keeps their ratio finite.
const FLUX_FLOOR: f64 = 0.02;
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
    /// ln theta, `[C, C]`: true class, then label. Rows of classes that win nowhere are negative infinity.
    log_confusion: Vec<f64>,
}

impl Calibration {
    /// Fits the calibration to `votes`, with class frequencies to the power of `exponent`.
    pub fn fit(votes: &PooledVotes, exponent: f64) -> Self {
        let prior = prior(votes);
        let factor = |prior: &f64| prior.max(MIN_SHARE).powf(-exponent);
        let factors: Vec<f64> = prior.iter().map(factor).collect();
        let mut divided = votes.clone();
        for row in divided.shares.chunks_exact_mut(votes.classes.max(1)) {
            divide(row, &factors);
        }
        Self {
            factors,
            log_confusion: Flux::new(divided.rows(), votes.classes).log_confusion(),
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

/// Class of the largest value, none where all are zero. Ties go to the lower index.
fn winner(row: &[f64]) -> Option<usize> {
    first_largest(row).filter(|&best| row[best] > 0.0)
}

fn normalise(row: &mut [f64]) {
    let sum: f64 = row.iter().sum();
    if sum > 0.0 {
        row.iter_mut().for_each(|value| *value /= sum);
    }
}

/// How much of the scene has which label, by winning class: `[C, C]` row-major, winner, then label.
struct Flux {
    classes: usize,
    table: Vec<f64>,
}

impl Flux {
    /// The flux of pieces of surface with these class shares and sizes.
    fn new<'a>(rows: impl Iterator<Item = (&'a [f64], f64)>, classes: usize) -> Self {
        let mut table = vec![0.0; classes * classes];
        for (row, size) in rows {
            if let Some(winner) = winner(row) {
                let to = &mut table[winner * classes..][..classes];
                to.iter_mut().zip(row).for_each(|(t, s)| *t += size * s);
            }
        }
        Self { classes, table }
    }

    fn at(&self, winner: usize, label: usize) -> f64 {
        self.table[winner * self.classes + label]
    }

    /// What each class wins, `[C]`.
    fn won(&self) -> Vec<f64> {
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

/// How labels err where they contradict the class that wins a piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelErrors {
    /// Share of the labels that contradict the winner.
    pub share: f64,
    /// How strongly errors prefer frequent classes: 0 where each class loses the same share of its area, 1 where as much area moves
    /// to the larger class of a pair as to the smaller one. A network that says wall wherever it is unsure is near 1.
    ///
    /// F_ab is the area labelled b in what a wins, and A_a the area that a wins. Labels that prefer no class have
    /// F_ab / F_ba = A_a / A_b. The preference g is the least-squares fit of ln(F_ab / F_ba) = (1 - g) ln(A_a / A_b) over all
    /// pairs, weighted by F_ab + F_ba.
    pub preference: f64,
}

impl LabelErrors {
    /// The errors in the class shares `rows` of pieces of surface, `[N, C]`. Leave out pieces at the border of two classes: there
    /// both lose alike.
    pub fn of<'a>(rows: impl Iterator<Item = &'a [f64]>, classes: usize) -> Self {
        let flux = Flux::new(rows.map(|row| (row, 1.0)), classes);
        let won = flux.won();
        let mut product = 0.0;
        let mut square = 0.0;
        for a in 0..classes {
            for b in 0..a {
                let both = flux.at(a, b) + flux.at(b, a);
                if both > 0.0 && won[a] > 0.0 && won[b] > 0.0 {
                    let floor = FLUX_FLOOR * both;
                    let flows = ((flux.at(a, b) + floor) / (flux.at(b, a) + floor)).ln();
                    let areas = (won[a] / won[b]).ln();
                    product += both * flows * areas;
                    square += both * areas * areas;
                }
            }
        }
        let total: f64 = won.iter().sum();
        let right: f64 = (0..classes).map(|c| flux.at(c, c)).sum();
        let rest = |part: f64, all: f64| if all > 0.0 { 1.0 - part / all } else { 0.0 };
        Self {
            share: rest(right, total),
            preference: rest(product, square),
        }
    }

    /// How far votes of such labels are pooled, 0 to 1. Labels with few errors are not: what contradicts the winner there is mostly
    /// blur at edges.
    pub fn pooling(&self) -> f64 {
        rise(self.share, ERROR_SHARES)
    }

    /// The exponent of class frequencies that pooled votes of such labels are divided by.
    pub fn exponent(&self) -> f64 {
        EXPONENT * rise(self.preference, PREFERENCES)
    }
}

/// 0 up to `low`, 1 from `high` on, linear between them.
fn rise(value: f64, [low, high]: [f64; 2]) -> f64 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
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
    fn errors_that_prefer_no_class_are_pooled_without_frequencies() {
        // Each class loses a quarter, to all others alike.
        let (votes, truth) = votes(|_, _| 0.06);
        let errors = LabelErrors::of(votes.rows().map(|row| row.0), COUNTS.len());
        assert!(errors.preference < 0.2, "{errors:?}");
        assert_eq!((errors.pooling(), errors.exponent()), (1.0, 0.0));
        assert_eq!(right(&votes.shares, &truth), truth.len());
    }

    #[test]
    fn few_errors_are_left_alone() {
        // All are taken for the frequent class, but seldom.
        let (votes, truth) = votes(|_, c| if c == 0 { 0.01 } else { 0.0 });
        let errors = LabelErrors::of(votes.rows().map(|row| row.0), COUNTS.len());
        assert!(errors.share < 0.02 && errors.preference > 0.5, "{errors:?}");
        assert_eq!(errors.pooling(), 0.0);
        let nothing = LabelErrors::of(std::iter::empty(), COUNTS.len());
        assert_eq!((nothing.pooling(), nothing.exponent()), (0.0, 0.0));
        assert_eq!(right(&votes.shares, &truth), truth.len());
    }

    #[test]
    fn a_class_that_is_named_too_often_gives_way() {
        // All are taken for the frequent class, often by most of their labels.
        let (votes, truth) = votes(|_, c| if c == 0 { 1.0 } else { 0.01 });
        let errors = LabelErrors::of(votes.rows().map(|row| row.0), COUNTS.len());
        assert_eq!((errors.pooling(), errors.exponent()), (1.0, EXPONENT));
        let calibration = Calibration::fit(&votes, EXPONENT);
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
        let calibration = Calibration::fit(&votes, 0.25);
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
        Calibration::fit(&none, EXPONENT).apply(&mut row);
        assert!(row.iter().all(|p| !p.is_nan()), "{row:?}");
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
        let rows = applied(&Calibration::fit(&votes, 0.0), &votes);
        let rare = rows.chunks_exact(COUNTS.len()).map(|row| row[4]);
        assert!(rare.into_iter().all(|p| p == 0.0));
    }
}
