//! What kind of errors the labels of a scene have, found without truth.
//!
//! A vote averages errors away that are independent from view to view. It keeps those that repeat, and a network's do: it says wall of
//! the same thing in every photo. To tell the two kinds apart, the views are divided into halves: errors that repeat are in both.

use super::Votes;
use super::calibration::{Flux, normalise, winner};

/// Exponent of class frequencies, unless settings give another.
const EXPONENT: f64 = 0.5;
/// Shares of errors between which pooling rises from 0 to all of it. True labels of three rooms had 0.012 to 0.021, those of a network
/// 0.07 to 0.12.
const ERROR_SHARES: [f64; 2] = [0.03, 0.06];
/// Repetitions between which the exponent rises likewise. Independent errors of these rooms had -0.14 to -0.01, those of the network
/// 0.32 to 0.41.
const REPETITIONS: [f64; 2] = [0.05, 0.15];
/// Preferences between which it rises likewise. Simulated errors that repeat had 0.13 to 0.21, those of the network 0.49 to 0.84.
const PREFERENCES: [f64; 2] = [0.25, 0.40];
/// Share of both fluxes of a pair that is added to each, which keeps their ratio finite.
const FLUX_FLOOR: f64 = 0.02;

/// How labels err where they contradict the class that wins a piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelErrors {
    /// Share of the labels that contradict the winner.
    pub share: f64,
    /// How strongly errors repeat from view to view: 0 or less where each view draws its own, 1 where all views err alike.
    ///
    /// It is Fisher's intraclass correlation of two halves of the views, 2 sum (x - m) (y - m) / sum ((x - m)^2 + (y - m)^2), where x and y
    /// are the shares of a Gaussian's labels in either half that name class c, and m is their mean over all Gaussians of one winner.
    /// The sums are over Gaussians and all classes but the winner.
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
    /// The errors in the votes of the two `halves` of the views, on the Gaussians that `counts` names, `[N]`. Leave out those at the border
    /// of two classes: there both lose alike.
    pub fn of(halves: [&Votes; 2], counts: &[bool]) -> Self {
        let classes = halves[0].classes;
        let mut flux = Flux::new(classes);
        let mut moments = ClassMoments::new(classes);
        let rows = halves[0].rows().zip(halves[1].rows()).zip(counts);
        for ((first, second), _) in rows.filter(|row| *row.1) {
            let [mut first, mut second] = [first, second].map(|row| {
                let votes = row.iter().map(|&vote| f64::from(vote));
                votes.collect::<Vec<_>>()
            });
            let mut both: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
            for row in [&mut first, &mut second, &mut both] {
                normalise(row);
            }
            flux.add(&both, 1.0);
            let in_both = [&first, &second].map(|row| row.iter().any(|&share| share > 0.0));
            if let Some(winner) = winner(&both).filter(|_| in_both == [true, true]) {
                moments.add(winner, &first, &second);
            }
        }
        let total: f64 = flux.won().iter().sum();
        let right: f64 = (0..classes).map(|c| flux.at(c, c)).sum();
        Self {
            share: rest(right, total),
            repetition: moments.repetition(),
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
        EXPONENT * rise(self.repetition, REPETITIONS) * rise(self.preference, PREFERENCES)
    }
}

/// Sums over Gaussians of the shares x and y that either half of the views gives a class.
#[derive(Clone, Copy, Default)]
struct Moments {
    count: f64,
    /// x + y.
    sum: f64,
    /// x^2 + y^2.
    squares: f64,
    /// x y.
    products: f64,
}

impl Moments {
    fn add(&mut self, x: f64, y: f64) {
        self.count += 1.0;
        self.sum += x + y;
        self.squares += x * x + y * y;
        self.products += x * y;
    }

    /// Sums of products and of squares about the mean.
    fn about_mean(&self) -> (f64, f64) {
        let mean = self.sum / (2.0 * self.count).max(1.0);
        let square = self.count * mean * mean;
        (self.products - square, self.squares - 2.0 * square)
    }
}

/// The moments of each winner and each class, `[C, C]`.
struct ClassMoments {
    classes: usize,
    table: Vec<Moments>,
}

impl ClassMoments {
    fn new(classes: usize) -> Self {
        Self {
            classes,
            table: vec![Moments::default(); classes * classes],
        }
    }

    /// Adds a Gaussian that `winner` wins, with the class shares of either half.
    fn add(&mut self, winner: usize, first: &[f64], second: &[f64]) {
        let moments = &mut self.table[winner * self.classes..][..self.classes];
        for (class, moments) in moments.iter_mut().enumerate() {
            if class != winner {
                moments.add(first[class], second[class]);
            }
        }
    }

    /// [`LabelErrors::repetition`].
    fn repetition(&self) -> f64 {
        let (mut products, mut squares) = (0.0, 0.0);
        for moments in &self.table {
            let (product, square) = moments.about_mean();
            products += product;
            squares += square;
        }
        if squares > 0.0 {
            2.0 * products / squares
        } else {
            0.0
        }
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
    const COUNTS: [usize; 4] = [2_000, 800, 400, 200];
    /// Views in each half.
    const VIEWS: usize = 8;
    /// How often a view errs.
    const ERRORS: f64 = 0.3;

    /// Which class labels name where they err.
    #[derive(Clone, Copy, PartialEq)]
    enum Wrong {
        Any,
        Frequent,
    }

    /// Votes in two halves of the views. Where labels err alike, all views of a Gaussian that err name the same class.
    fn halves(wrong: Wrong, alike: bool) -> [Votes; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let classes = COUNTS.len();
        let mut tables = [Vec::new(), Vec::new()];
        for truth in (0..classes).flat_map(|class| vec![class; COUNTS[class]]) {
            let mut draw = |rate: f64| {
                let class = rng.random_range(0..classes);
                let frequent = wrong == Wrong::Frequent && rng.random_bool(0.9);
                let error = if frequent { 0 } else { class };
                if rng.random_bool(rate) { error } else { truth }
            };
            let lasting = draw(if alike { ERRORS } else { 0.0 });
            for table in &mut tables {
                let mut row = [0.0; COUNTS.len()];
                for _ in 0..VIEWS {
                    row[draw(if alike { 0.0 } else { ERRORS })] += 1.0;
                }
                // Errors that last are in a third of the views: the truth still wins.
                row[lasting] += VIEWS as f32 / 2.0;
                table.extend(row);
            }
        }
        tables.map(|table| Votes { table, classes })
    }

    fn errors(wrong: Wrong, alike: bool) -> LabelErrors {
        let [first, second] = halves(wrong, alike);
        let all = vec![true; first.rows().len()];
        LabelErrors::of([&first, &second], &all)
    }

    #[test]
    fn errors_that_each_view_draws_are_pooled_alone() {
        for wrong in [Wrong::Any, Wrong::Frequent] {
            let errors = errors(wrong, false);
            assert!(errors.repetition.abs() < REPETITIONS[0], "{errors:?}");
            assert_eq!((errors.pooling(), errors.exponent()), (1.0, 0.0));
        }
    }

    #[test]
    fn errors_that_repeat_without_preference_are_pooled_alone() {
        let errors = errors(Wrong::Any, true);
        assert!((errors.repetition - 1.0).abs() < 1e-6, "{errors:?}");
        assert!(errors.preference < 0.2, "{errors:?}");
        assert_eq!((errors.pooling(), errors.exponent()), (1.0, 0.0));
    }

    #[test]
    fn class_frequencies_are_divided_out_of_errors_that_repeat_and_prefer_frequent_classes() {
        let errors = errors(Wrong::Frequent, true);
        assert!(errors.preference > 0.5, "{errors:?}");
        assert_eq!(errors.exponent(), EXPONENT);
    }

    #[test]
    fn few_errors_are_left_alone() {
        // One in a hundred labels of three classes names the most frequent one, in both halves.
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
        let errors = LabelErrors::of([&votes, &votes], &all);
        assert!(errors.share < 0.01 && errors.preference > 0.5, "{errors:?}");
        assert_eq!(errors.pooling(), 0.0);
    }

    #[test]
    fn the_correlation_is_about_the_mean_of_each_winner() {
        // Class 1 errs more than class 0, but alike in its Gaussians. Those of class 0 err by 0.1 and 0.2.
        let votes = |rows: [[f32; 2]; 4]| Votes {
            table: rows.concat(),
            classes: 2,
        };
        let [a, b, c] = [[9.0, 1.0], [8.0, 2.0], [2.0, 4.0]];
        let first = votes([a, b, c, c]);
        let repetition = |second| LabelErrors::of([&first, &second], &[true; 4]).repetition;
        assert!((repetition(votes([a, b, c, c])) - 1.0).abs() < 1e-6);
        assert!((repetition(votes([b, a, c, c])) + 1.0).abs() < 1e-6);
        // About the mean 0.125: x of -0.025 and 0.075, y of -0.025 twice.
        let expected = 2.0 * (0.000_625 - 0.001_875) / (0.006_25 + 0.001_25);
        assert!((repetition(votes([a, a, c, c])) - expected).abs() < 1e-6);
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
        assert_eq!(LabelErrors::of([&none, &none], &[]), zeros);
        // What only one half shows says nothing of repetition.
        let [seen, unseen] = [votes(vec![3.0, 1.0, 1.0, 3.0]), votes(vec![0.0; 4])];
        let errors = LabelErrors::of([&seen, &unseen], &[true; 2]);
        assert_eq!((errors.share, errors.repetition), (0.25, 0.0));
    }
}
