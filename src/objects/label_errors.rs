//! What kind of errors the labels of a scene have, found without truth.
//!
//! A vote averages errors away that are independent from view to view. It keeps those that repeat, and a network's do: it says wall of
//! the same thing in most photos. To tell the two kinds apart, the views are divided into quarters. Where errors repeat, two quarters
//! disagree about the Gaussians that the other two disagree about.

use super::Votes;
use super::calibration::{Flux, normalise};
use crate::data::winner;

/// Exponent of class frequencies, unless settings give another.
const EXPONENT: f64 = 0.5;
/// Shares of errors between which pooling rises from 0 to all of it. True labels of three rooms had 0.011 to 0.021, those of a network
/// 0.031 to 0.12, the fewer the fewer photos had labels.
const ERROR_SHARES: [f64; 2] = [0.022, 0.032];
/// Repetition times preference, between which the exponent rises likewise. Simulated errors of these rooms had 0.025 at most, those of
/// the network 0.06 to 0.10, and with 16 photos 0.02 to 0.045.
const SYSTEMATIC: [f64; 2] = [0.025, 0.045];
/// Share of both fluxes of a pair that is added to each, which keeps their ratio finite.
const FLUX_FLOOR: f64 = 0.02;

/// How labels err where they contradict the class that wins a piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelErrors {
    /// Share of the labels that contradict the winner.
    pub share: f64,
    /// How strongly errors repeat from view to view: 0 or less where each view draws its own.
    ///
    /// D_ab = 1 - sum_c a_c b_c is how often labels of a Gaussian in the quarters a and b differ, of which a_c and b_c name class c.
    /// The repetition is the covariance of D_ab and D_cd, of other quarters, over D (1 - D), the largest that the mean D allows. Means are
    /// over the Gaussians of one winner, and all three ways to pair the quarters count. Neither term depends on how many views a
    /// quarter has, unlike a correlation of D_ab and D_cd.
    pub repetition: f64,
    /// How strongly errors prefer frequent classes: 0 where each class loses the same share of its area, 1 where as much area moves
    /// to the larger class of a pair as to the smaller one. A network that says wall wherever it is unsure is near 1.
    ///
    /// F_ab is the area labelled b in what a wins, and A_a the area that a wins. Labels that prefer no class have
    /// F_ab / F_ba = A_a / A_b. The preference g is the least-squares fit of ln(F_ab / F_ba) = (1 - g) ln(A_a / A_b) over all
    /// pairs, weighted by F_ab + F_ba.
    pub preference: f64,
}

impl LabelErrors {
    /// The errors in the votes of four `quarters` of the views, on the Gaussians that `counts` names, `[N]`. Leave out those at the
    /// border of two classes: there both lose alike.
    pub fn of(quarters: [&Votes; 4], counts: &[bool]) -> Self {
        let classes = quarters[0].classes;
        let mut flux = Flux::new(classes);
        let mut moments = vec![Moments::default(); classes];
        for i in (0..counts.len()).filter(|&i| counts[i]) {
            let mut parts: [Vec<f64>; 4] = quarters.map(|votes| as_f64(votes.row(i)));
            let sum = |class| parts.iter().map(|part| part[class]).sum();
            let mut all: Vec<f64> = (0..classes).map(sum).collect();
            normalise(&mut all);
            flux.add(&all, 1.0);
            parts.iter_mut().for_each(|part| normalise(part));
            let in_each = parts
                .iter()
                .all(|part| part.iter().any(|&share| share > 0.0));
            if let Some(winner) = winner(&all).filter(|_| in_each) {
                moments[winner].add(&parts);
            }
        }
        let total: f64 = flux.won().iter().sum();
        let right: f64 = (0..classes).map(|c| flux.at(c, c)).sum();
        Self {
            share: rest(right, total),
            repetition: repetition(&moments),
            preference: preference(&flux, classes),
        }
    }

    /// How far votes of such labels are pooled, 0 to 1. Labels with few errors are not: what contradicts the winner there is mostly
    /// blur at edges.
    pub fn pooling(&self) -> f64 {
        rise(self.share, ERROR_SHARES)
    }

    /// The exponent of class frequencies that pooled votes of such labels are divided by. A vote averages errors away that do not repeat,
    /// whichever class they prefer.
    pub fn exponent(&self) -> f64 {
        let systematic = self.repetition.max(0.0) * self.preference.max(0.0);
        EXPONENT * rise(systematic, SYSTEMATIC)
    }
}

fn as_f64(votes: &[f32]) -> Vec<f64> {
    votes.iter().map(|&vote| f64::from(vote)).collect()
}

/// The three ways to pair four quarters.
const PAIRINGS: [[[usize; 2]; 2]; 3] = [[[0, 1], [2, 3]], [[0, 2], [1, 3]], [[0, 3], [1, 2]]];

/// Sums over the Gaussians of one winner, and over [`PAIRINGS`], of how often two quarters differ, x, and the other two, y.
#[derive(Clone, Copy, Default)]
struct Moments {
    count: f64,
    /// x + y.
    sum: f64,
    /// x y.
    products: f64,
}

impl Moments {
    /// Adds a Gaussian, given its class shares in each quarter.
    fn add(&mut self, quarters: &[Vec<f64>; 4]) {
        let differ = |[a, b]: [usize; 2]| {
            let same = quarters[a].iter().zip(&quarters[b]).map(|(a, b)| a * b);
            1.0 - same.sum::<f64>()
        };
        for pairs in PAIRINGS {
            let [x, y] = pairs.map(differ);
            self.count += 1.0;
            self.sum += x + y;
            self.products += x * y;
        }
    }
}

/// [`LabelErrors::repetition`], of the moments of each winner.
fn repetition(moments: &[Moments]) -> f64 {
    let (mut covariance, mut largest) = (0.0, 0.0);
    for moments in moments.iter().filter(|moments| moments.count > 0.0) {
        let mean = moments.sum / (2.0 * moments.count);
        covariance += moments.products - moments.count * mean * mean;
        largest += moments.count * mean * (1.0 - mean);
    }
    if largest > 0.0 {
        covariance / largest
    } else {
        0.0
    }
}

/// [`LabelErrors::preference`].
fn preference(flux: &Flux, classes: usize) -> f64 {
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
    rest(product, square)
}

/// 1 - part / all, or 0 of nothing.
fn rest(part: f64, all: f64) -> f64 {
    if all > 0.0 { 1.0 - part / all } else { 0.0 }
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

    /// Gaussians of each class, from a frequent one to a rare one.
    const COUNTS: [usize; 4] = [4_000, 1_600, 800, 400];

    /// How the labels of a Gaussian err.
    #[derive(Clone, Copy)]
    struct Errors {
        /// The rate at which views err on the first half of each class, and on the second.
        rates: [f64; 2],
        /// Whether errors name the most frequent class, and its own labels are right, instead of any other class.
        frequent: bool,
    }

    const INDEPENDENT: Errors = Errors {
        rates: [0.2; 2],
        frequent: false,
    };
    const REPEATED: Errors = Errors {
        rates: [0.25, 0.0],
        ..INDEPENDENT
    };
    const OF_A_NETWORK: Errors = Errors {
        frequent: true,
        ..REPEATED
    };

    /// Votes of `views` views in each quarter. All errors of a Gaussian name one class.
    fn quarters(errors: Errors, views: usize) -> [Votes; 4] {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let classes = COUNTS.len();
        let mut tables = [const { Vec::new() }; 4];
        for truth in 0..classes {
            for i in 0..COUNTS[truth] {
                let other = (truth + rng.random_range(1..classes)) % classes;
                let wrong = if errors.frequent { 0 } else { other };
                let rate = match (errors.frequent, truth) {
                    (true, 0) => 0.0,
                    _ => errors.rates[2 * i / COUNTS[truth]],
                };
                for table in &mut tables {
                    let mut row = [0.0; COUNTS.len()];
                    for _ in 0..views {
                        row[if rng.random_bool(rate) { wrong } else { truth }] += 1.0;
                    }
                    table.extend(row);
                }
            }
        }
        tables.map(|table| Votes { table, classes })
    }

    fn errors(errors: Errors, views: usize) -> LabelErrors {
        let quarters = quarters(errors, views);
        let all = vec![true; quarters[0].rows().len()];
        LabelErrors::of(quarters.each_ref(), &all)
    }

    #[test]
    fn errors_that_each_view_draws_are_pooled_alone() {
        let preferring = Errors {
            frequent: true,
            ..INDEPENDENT
        };
        // With one or two views in a quarter, errors that name the same class win some Gaussians.
        for (kind, views) in [
            (INDEPENDENT, 1),
            (INDEPENDENT, 8),
            (preferring, 4),
            (preferring, 8),
        ] {
            let errors = errors(kind, views);
            assert!(errors.repetition < 0.02, "{errors:?}");
            assert_eq!((errors.pooling(), errors.exponent()), (1.0, 0.0));
        }
    }

    #[test]
    fn errors_that_repeat_without_preference_are_pooled_alone() {
        let errors = errors(REPEATED, 8);
        assert!(
            errors.repetition > 0.2 && errors.preference < 0.05,
            "{errors:?}"
        );
        assert_eq!((errors.pooling(), errors.exponent()), (1.0, 0.0));
    }

    #[test]
    fn class_frequencies_are_divided_out_of_errors_that_repeat_and_prefer_frequent_classes() {
        for views in [1, 2, 8] {
            let errors = errors(OF_A_NETWORK, views);
            assert!(errors.preference > 0.5, "{errors:?}");
            assert_eq!(errors.exponent(), EXPONENT, "{errors:?}");
        }
    }

    #[test]
    fn repetition_does_not_depend_on_the_number_of_views() {
        // On one half of the Gaussians labels of two views differ with 2 * 0.25 * 0.75, on the other never.
        let [differ, mean]: [f64; 2] = [0.375, 0.1875];
        let expected = (0.5 * differ * differ - mean * mean) / (mean * (1.0 - mean));
        for views in [4, 8, 32] {
            let found = errors(REPEATED, views).repetition;
            assert!(
                (found - expected).abs() < 0.02,
                "{views}: {found} for {expected}"
            );
        }
        // With one view, some errors win their Gaussian.
        assert!((errors(REPEATED, 1).repetition - expected).abs() < 0.1);
    }

    #[test]
    fn few_errors_are_left_alone() {
        // One in a hundred labels of three classes names the most frequent one, in all quarters.
        let row = |class: usize| -> [f32; 4] {
            std::array::from_fn(|c| match (c == class, c == 0) {
                (true, _) => 99.0,
                (false, true) => 1.0,
                _ => 0.0,
            })
        };
        let rows = (0..COUNTS.len()).flat_map(|class| vec![row(class); COUNTS[class]]);
        let votes = Votes {
            table: rows.flatten().collect(),
            classes: COUNTS.len(),
        };
        let all = vec![true; votes.rows().len()];
        let errors = LabelErrors::of([&votes; 4], &all);
        assert!(errors.share < 0.01 && errors.preference > 0.5, "{errors:?}");
        assert_eq!(errors.pooling(), 0.0);
    }

    #[test]
    fn the_covariance_is_about_the_mean_of_each_winner() {
        let votes = |rows: [[f32; 2]; 3]| Votes {
            table: rows.concat(),
            classes: 2,
        };
        let (right, wrong) = ([1.0, 0.0], [0.0, 1.0]);
        // Class 0 wins the first two Gaussians, and class 1 the last one.
        let all_right = votes([right, right, wrong]);
        let one_wrong = votes([wrong, right, wrong]);
        let repetition = |quarters| LabelErrors::of(quarters, &[true; 3]).repetition;
        // Of the first Gaussian, the wrong quarter differs from any other, and the other pair agrees: x y = 0, x + y = 1.
        let quarters = [&one_wrong, &all_right, &all_right, &all_right];
        assert!((repetition(quarters) + 1.0 / 3.0).abs() < 1e-12);
        // Two quarters half wrong and two right: x = y = 0.5 in two pairings, and x = 0.5, y = 0 in one.
        let half = votes([[0.5, 0.5], right, wrong]);
        let mean = (4.0 * 0.5 + 0.5) / 12.0;
        let expected = (0.5 - 6.0 * mean * mean) / (6.0 * mean * (1.0 - mean));
        let found = repetition([&half, &half, &all_right, &all_right]);
        assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
    }

    #[test]
    fn nothing_says_nothing() {
        let votes = |table: Vec<f32>| Votes { table, classes: 2 };
        let zeros = LabelErrors {
            share: 0.0,
            repetition: 0.0,
            preference: 0.0,
        };
        let none = votes(Vec::new());
        assert_eq!(LabelErrors::of([&none; 4], &[]), zeros);
        // What not every quarter shows says nothing of repetition.
        let [seen, unseen] = [votes(vec![3.0, 1.0, 1.0, 3.0]), votes(vec![0.0; 4])];
        let errors = LabelErrors::of([&seen, &seen, &seen, &unseen], &[true; 2]);
        assert_eq!((errors.share, errors.repetition), (0.25, 0.0));
    }
}
