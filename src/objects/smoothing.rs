//! Smoothing over surfaces: a Gaussian that hardly any labelled pixel shows takes the scores of its superpoint.

use super::pooled_vote::PooledVotes;
use super::superpoints::{NEIGHBOURS, SurfaceGraph};
use super::{Identities, Votes};
use crate::error::Result;
use crate::splat::Gaussians;

/// Identities `s_i + m_i (mean_j s_j - s_i)` of `identities` s, class probabilities. The mean is over all Gaussians j in the
/// superpoint of Gaussian i, and `m_i = 1 / (1 + v_i)` for the v_i pixels that `votes` has of it.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a centre is not finite.
///
/// # Panics
/// If `identities` or `votes` are of another number of Gaussians, or differ in their classes.
pub fn smoothed(
    gaussians: &Gaussians,
    mut identities: Identities,
    votes: &Votes,
) -> Result<Identities> {
    let size = [gaussians.len() * votes.classes, votes.classes];
    assert_eq!(
        [identities.scores.len(), identities.classes],
        size,
        "one score for each Gaussian and class"
    );
    let superpoints = SurfaceGraph::new(gaussians, NEIGHBOURS)?.middle();
    let probabilities = Votes {
        table: identities.scores.clone(),
        classes: identities.classes,
    };
    let pooled = PooledVotes::new(&probabilities, &superpoints);
    let rows = identities.scores.chunks_exact_mut(votes.classes.max(1));
    for ((scores, votes), &superpoint) in rows.zip(votes.rows()).zip(&superpoints.of) {
        let part = (1.0 + votes.iter().sum::<f32>()).recip();
        for (score, &mean) in scores.iter_mut().zip(pooled.row(superpoint)) {
            *score += part * (mean as f32 - *score);
        }
    }
    Ok(identities)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat patch of one colour, 8 x 8 Gaussians.
    fn patch() -> Gaussians {
        let n = 64;
        Gaussians {
            means: (0..n)
                .map(|i| [(i % 8) as f32 * 0.05, (i / 8) as f32 * 0.05, 0.0])
                .collect(),
            log_scales: vec![[-4.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![2.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        }
    }

    #[test]
    fn the_fewer_votes_the_more_of_the_superpoint() {
        let gaussians = patch();
        let n = gaussians.len();
        // A quarter is sure of the second class. Gaussian 0 has no votes, the others one each but the last, which has nine.
        let second = |i: usize| i.is_multiple_of(4);
        let scores = (0..n).flat_map(|i| if second(i) { [0.0, 1.0] } else { [1.0, 0.0] });
        let count = |i: usize| match i {
            0 => 0.0,
            63 => 9.0,
            _ => 1.0,
        };
        let identities = Identities {
            scores: scores.collect(),
            classes: 2,
        };
        let votes = Votes {
            table: (0..n).flat_map(|i| [count(i), 0.0]).collect(),
            classes: 2,
        };
        let smoothed = smoothed(&gaussians, identities, &votes).unwrap();
        let row = |i: usize| &smoothed.scores[2 * i..2 * i + 2];
        let expected = |own: f32, part: f32| own + part * (0.25 - own);
        for (i, own, part) in [(0, 1.0, 1.0), (1, 0.0, 0.5), (4, 1.0, 0.5), (63, 0.0, 0.1)] {
            let second = expected(own, part);
            assert!((row(i)[1] - second).abs() < 1e-6, "{i}: {:?}", row(i));
            assert!((row(i).iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn nothing_is_smoothed_without_gaussians() {
        let nothing = Identities {
            scores: Vec::new(),
            classes: 3,
        };
        let votes = Votes {
            table: Vec::new(),
            classes: 3,
        };
        let smoothed = smoothed(&Gaussians::default(), nothing.clone(), &votes).unwrap();
        assert_eq!(smoothed, nothing);
    }
}
