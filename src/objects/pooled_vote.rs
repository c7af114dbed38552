//! The pooled vote: raw labels vote for the surface patch that they show, not for single Gaussians.
//!
//! The class shares of a Gaussian are a weighted mean of its own votes and of those of the superpoints that hold it, at several
//! scales: a superpoint that reaches across two objects costs little then. [`Calibration`] corrects them for systematic errors.

use super::label_errors::LabelErrors;
use super::superpoints::{NEIGHBOURS, Superpoints, SurfaceGraph};
use super::{Calibration, Identities, Votes};
use crate::config::PoolingConfig;
use crate::error::Result;
use crate::splat::Gaussians;
use rayon::prelude::*;

/// Weight of a Gaussian's own votes beside those of the superpoints of each scale: as much as all of them.
const OWN: f64 = 3.0;
/// Index of the scale that the calibration is fitted on: the middle one.
const FITTED: usize = 1;

/// Votes of superpoints.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledVotes {
    /// Mean share of each class over the Gaussians with votes, `[S, C]` row-major; zeros where there are none.
    pub shares: Vec<f64>,
    /// Number of Gaussians with votes in each superpoint, `[S]`.
    pub sizes: Vec<f64>,
    /// C.
    pub classes: usize,
}

impl PooledVotes {
    /// Pools `votes` over `superpoints`. Each Gaussian with votes counts the same, however many pixels show it.
    ///
    /// # Panics
    /// If the votes are of another number of Gaussians.
    pub fn new(votes: &Votes, superpoints: &Superpoints) -> Self {
        let classes = votes.classes;
        let count = superpoints.count;
        assert_eq!(
            votes.table.len(),
            superpoints.of.len() * classes,
            "one row of votes for each Gaussian"
        );
        let mut shares = vec![0.0; count * classes];
        let mut sizes = vec![0.0; count];
        for (row, &superpoint) in votes.rows().zip(&superpoints.of) {
            let superpoint = superpoint as usize;
            if add_shares(&mut shares[superpoint * classes..][..classes], row) {
                sizes[superpoint] += 1.0;
            }
        }
        for (row, &size) in shares.chunks_exact_mut(classes.max(1)).zip(&sizes) {
            row.iter_mut()
                .for_each(|share| *share /= f64::max(size, 1.0));
        }
        Self {
            shares,
            sizes,
            classes,
        }
    }

    /// Shares and size of each superpoint.
    pub fn rows(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let shares = self.shares.chunks_exact(self.classes.max(1));
        shares.zip(self.sizes.iter().copied())
    }

    /// Shares of superpoint `index`.
    pub(super) fn row(&self, index: u32) -> &[f64] {
        &self.shares[index as usize * self.classes..][..self.classes]
    }
}

/// The pooled vote of a scene.
#[derive(Clone, Debug)]
pub struct PooledVote {
    /// Class probabilities of each Gaussian; zeros where nothing was voted on it and its superpoints.
    pub identities: Identities,
    /// Exponent of the class frequencies that were divided out.
    pub exponent: f64,
}

/// Pools the votes `refined` ([`refined_vote`](super::refined_vote)) over superpoints and calibrates them where the plain votes of four
/// `quarters` of the views say that labels contradict their surface. Class frequencies are divided out where these errors repeat from
/// view to view and prefer frequent classes: a network makes such errors. `config` may turn the corrections off, or name the exponent.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a centre is not finite.
///
/// # Panics
/// If votes are of another number of Gaussians or classes.
pub fn pooled_vote(
    gaussians: &Gaussians,
    quarters: [&Votes; 4],
    refined: &Votes,
    config: &PoolingConfig,
) -> Result<PooledVote> {
    let classes = refined.classes;
    let graph = SurfaceGraph::new(gaussians, NEIGHBOURS)?;
    let errors = errors_inside(quarters, &graph);
    let pooling = config.exponent.map_or_else(|| errors.pooling(), |_| 1.0);
    let exponent = match config.exponent {
        Some(exponent) => exponent,
        // Hardly any errors, so nothing is divided out of what Gaussians without votes take from their superpoints either.
        None if pooling == 0.0 => 0.0,
        None => errors.exponent(),
    };
    let superpoints = graph.all_scales();
    let pooled = superpoints.each_ref().map(|s| PooledVotes::new(refined, s));
    let calibration = Calibration::fit(&pooled[FITTED], exponent, config.confusion);
    tracing::info!(
        "{} superpoints; {:.4} of the labels contradict their surface; these errors repeat by {:.2} and prefer frequent classes by {:.2}; pooled by {pooling:.2}, exponent {exponent:.2}",
        superpoints[FITTED].count,
        errors.share,
        errors.repetition,
        errors.preference
    );
    let mut scores = vec![0.0; refined.table.len()];
    let rows = scores.par_chunks_exact_mut(classes.max(1));
    let rows = rows.zip(refined.table.par_chunks_exact(classes.max(1)));
    rows.enumerate().for_each(|(gaussian, (scores, votes))| {
        let mut own_shares = vec![0.0; classes];
        let voted = add_shares(&mut own_shares, votes);
        let mut shares: Vec<f64> = own_shares.iter().map(|share| OWN * share).collect();
        if config.superpoints || !voted {
            for (pooled, superpoints) in pooled.iter().zip(&superpoints) {
                let row = pooled.row(superpoints.of[gaussian]);
                shares.iter_mut().zip(row).for_each(|(s, p)| *s += p);
            }
        }
        calibration.apply(&mut shares);
        let pooling = if voted { pooling } else { 1.0 };
        for ((score, p), own) in scores.iter_mut().zip(shares).zip(own_shares) {
            *score = (pooling * p + (1.0 - pooling) * own) as f32;
        }
    });
    let identities = Identities { scores, classes };
    Ok(PooledVote {
        identities,
        exponent,
    })
}

/// The errors of the labels on Gaussians whose neighbours, and theirs, have the same winner: at the border of two objects
/// both lose alike.
fn errors_inside(quarters: [&Votes; 4], graph: &SurfaceGraph) -> LabelErrors {
    let inside = graph.inside(&Votes::of_all(quarters).winners());
    LabelErrors::of(quarters, &inside)
}

/// Adds the class shares of `votes` to `sums`. Returns whether there are votes.
fn add_shares(sums: &mut [f64], votes: &[f32]) -> bool {
    let total: f64 = votes.iter().map(|&v| f64::from(v)).sum();
    if total <= 0.0 {
        return false;
    }
    let shares = votes.iter().map(|&v| f64::from(v) / total);
    sums.iter_mut()
        .zip(shares)
        .for_each(|(sum, share)| *sum += share);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Pooled, whatever the labels, and not divided by class frequencies.
    const POOLED: PoolingConfig = PoolingConfig {
        distance: true,
        superpoints: true,
        confusion: true,
        exponent: Some(0.0),
    };

    /// Two squares of 20 x 20 Gaussians side by side on one plane, the left one grey and the right one red.
    fn squares() -> Gaussians {
        let cells = (0..800).map(|i| (i % 40, i / 40));
        let grey_or_red = |x: usize| {
            if x < 20 {
                [0.5, 0.5, 0.5]
            } else {
                [0.9, 0.2, 0.2]
            }
        };
        let colors: Vec<[f32; 3]> = cells.clone().map(|(x, _)| grey_or_red(x)).collect();
        let means: Vec<[f32; 3]> = cells
            .map(|(x, y)| [x as f32 * 0.05, y as f32 * 0.05, 0.0])
            .collect();
        let n = means.len();
        Gaussians {
            means,
            log_scales: vec![[-4.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![2.0; n],
            sh: colors
                .as_flattened()
                .iter()
                .map(|c| (c - 0.5) / crate::splat::SH_0)
                .collect(),
            sh_degree: 0,
        }
    }

    #[test]
    fn neighbours_on_a_surface_correct_a_noisy_vote() {
        let gaussians = squares();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut table = Vec::new();
        for i in 0..gaussians.means.len() {
            let class = usize::from(i % 40 >= 20);
            // Three in ten have most of their votes for the other class; one in ten sees nothing.
            let right = if rng.random_bool(0.3) { 0.35 } else { 1.0 };
            let votes = if rng.random_bool(0.1) {
                0.0
            } else {
                rng.random_range(1.0..9.0)
            };
            let mut row = [0.0; 3];
            row[class] = votes * right;
            row[1 - class] = votes * (1.0 - right);
            table.extend(row);
        }
        let votes = Votes { table, classes: 3 };
        let pooled = |config: &PoolingConfig| {
            let pooled = pooled_vote(&gaussians, [&votes; 4], &votes, config);
            pooled.unwrap().identities
        };
        let identities = pooled(&POOLED);
        for (i, row) in identities.scores.chunks_exact(3).enumerate() {
            let class = usize::from(i % 40 >= 20);
            assert!(row[class] > row[1 - class] && row[2] == 0.0, "{i}: {row:?}");
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{i}: {row:?}");
        }
        let plain = PoolingConfig {
            confusion: false,
            ..POOLED
        };
        let together = pooled(&plain);
        let apart = pooled(&PoolingConfig {
            superpoints: false,
            ..plain
        });
        let shares = votes.shares();
        for (i, row) in apart.scores.chunks_exact(3).enumerate() {
            let own = shares.row(i);
            if own.iter().any(|&share| share > 0.0) {
                let close = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
                assert!(row.iter().zip(own).all(close), "{i}: {row:?}");
            } else {
                assert_eq!(row, &together.scores[3 * i..][..3], "{i}");
            }
        }
    }

    #[test]
    fn class_frequencies_are_not_divided_out_where_labels_have_few_errors() {
        let gaussians = squares();
        // One in 16 votes is for grey on every other Gaussian of red. Half of red, and a fifth of grey, have no votes.
        let is_red = |i: usize| i % 40 >= 20;
        let is_voted = |i: usize| i / 40 >= if is_red(i) { 10 } else { 4 };
        let row = |i: usize| match (is_voted(i), is_red(i)) {
            (false, _) => [0.0, 0.0],
            (true, false) => [1.0, 0.0],
            (true, true) if i.is_multiple_of(2) => [1.0 / 16.0, 15.0 / 16.0],
            (true, true) => [0.0, 1.0],
        };
        let table = (0..gaussians.means.len()).flat_map(row).collect();
        let votes = Votes { table, classes: 2 };
        let graph = SurfaceGraph::new(&gaussians, NEIGHBOURS).unwrap();
        let errors = errors_inside([&votes; 4], &graph);
        assert!(errors.pooling() == 0.0 && errors.exponent() > 0.0);

        let plain =
            pooled_vote(&gaussians, [&votes; 4], &votes, &PoolingConfig::default()).unwrap();
        assert_eq!(plain.exponent, 0.0);
        let pooled = pooled_vote(&gaussians, [&votes; 4], &votes, &POOLED).unwrap();
        let rows = plain.identities.scores.chunks_exact(2);
        let rows = rows.zip(pooled.identities.scores.chunks_exact(2));
        for (i, (plain, pooled)) in rows.enumerate() {
            let votes = row(i);
            let expected = if is_voted(i) { &votes } else { pooled };
            assert_eq!(plain, expected, "{i}");
        }
    }

    #[test]
    fn each_gaussian_with_votes_counts_the_same() {
        let superpoints = Superpoints {
            of: vec![0, 0, 0, 1],
            count: 2,
        };
        let votes = Votes {
            table: vec![100.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0],
            classes: 2,
        };
        let pooled = PooledVotes::new(&votes, &superpoints);
        assert_eq!(pooled.shares, [0.75, 0.25, 0.0, 0.0]);
        assert_eq!(pooled.sizes, [2.0, 0.0]);
        assert_eq!(pooled.row(0), [0.75, 0.25]);
    }
}
