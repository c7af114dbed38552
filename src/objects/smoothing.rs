//! Smoothing over surfaces: a Gaussian that hardly any labelled pixel shows takes the scores of its neighbours on the same surface.

use super::superpoints::{NEIGHBOURS, SurfaceGraph};
use super::{Identities, Votes};
use crate::error::Result;
use crate::splat::Gaussians;

/// Edge weight at which the affinity of two neighbours has fallen to 1/e.
const DECAY: f32 = 0.2;
/// Pixels for which the own scores of a Gaussian count, besides the labelled ones that show it.
const OWN: f32 = 0.1;
/// Steps of the iteration. Scores travel over as many edges at most.
const STEPS: usize = 50;

/// `identities` s, class probabilities, after 50 steps of Jacobi's method, from x = s, towards the least
///
/// ```text
/// sum over Gaussians i of (0.1 + v_i) |x_i - s_i|^2  +  sum over edges ij of w_ij |x_i - x_j|^2
/// ```
///
/// `votes` has v_i pixels of Gaussian i. The edges are those of [`SurfaceGraph`], and w_ij = exp(-e_ij / 0.2) for the weight e_ij of an
/// edge. So scores stay where many labelled pixels show a Gaussian, and elsewhere become those of neighbours on one surface, over 50
/// edges at most. (Zhu, Ghahramani and Lafferty, *Semi-Supervised Learning Using Gaussian Fields and Harmonic Functions*, ICML 2003,
/// where labelled points are held exactly and others not at all.)
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
    let classes = votes.classes;
    assert_eq!(
        [identities.scores.len(), identities.classes],
        [gaussians.len() * classes, classes],
        "one score for each Gaussian and class"
    );
    let affinities = SurfaceGraph::new(gaussians, NEIGHBOURS)?.affinities(DECAY);
    let held: Vec<f32> = votes
        .rows()
        .map(|row| OWN + row.iter().sum::<f32>())
        .collect();
    let near = |i: usize| affinities.row(i).1.iter().sum::<f32>();
    let total: Vec<f32> = (0..).zip(&held).map(|(i, held)| held + near(i)).collect();
    let own = identities.scores.clone();
    let width = classes.max(1);
    for _ in 0..STEPS {
        let mut next = affinities.apply(&identities.scores, classes);
        let rows = next.chunks_exact_mut(width).zip(own.chunks_exact(width));
        for (i, (row, own)) in rows.enumerate() {
            for (x, s) in row.iter_mut().zip(own) {
                *x = (*x + held[i] * s) / total[i];
            }
        }
        identities.scores = next;
    }
    Ok(identities)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    const SIDE: usize = 8;
    const N: usize = SIDE * SIDE;

    /// A flat patch of 8 x 8 Gaussians; those in columns from `first_red` on are red, the others grey.
    fn patch(first_red: usize) -> Gaussians {
        let grey = |i: usize| i % SIDE < first_red;
        let color = |i: usize| if grey(i) { [0.5; 3] } else { [0.9, 0.2, 0.2] };
        Gaussians {
            means: (0..N)
                .map(|i| [(i % SIDE) as f32 * 0.05, (i / SIDE) as f32 * 0.05, 0.0])
                .collect(),
            log_scales: vec![[-4.0; 3]; N],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; N],
            opacity_logits: vec![2.0; N],
            sh: (0..N)
                .flat_map(|i| color(i).map(|c| (c - 0.5) / crate::splat::SH_0))
                .collect(),
            sh_degree: 0,
        }
    }

    fn two_classes(of: impl Fn(usize) -> [f32; 2]) -> Vec<f32> {
        (0..N).flat_map(of).collect()
    }

    fn identities(of: impl Fn(usize) -> [f32; 2]) -> Identities {
        Identities {
            scores: two_classes(of),
            classes: 2,
        }
    }

    /// Pixels of the first class.
    fn votes(of: impl Fn(usize) -> f32) -> Votes {
        Votes {
            table: two_classes(|i| [of(i), 0.0]),
            classes: 2,
        }
    }

    #[test]
    fn scores_travel_over_a_surface_and_stop_at_its_edge() {
        // A labelled Gaussian in each half. The others know nothing.
        let known = |i: usize| match i {
            0 => [1.0, 0.0],
            63 => [0.0, 1.0],
            _ => [0.5, 0.5],
        };
        let votes = votes(|i| if [0, 63].contains(&i) { 20.0 } else { 0.0 });
        let smoothed = smoothed(&patch(4), identities(known), &votes).unwrap();
        for (i, row) in smoothed.scores.chunks_exact(2).enumerate() {
            assert_eq!(row[0] > row[1], i % SIDE < 4, "{i}: {row:?}");
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{i}: {row:?}");
        }
    }

    #[test]
    fn what_many_labelled_pixels_show_stays() {
        let alternating = |i: usize| {
            if i.is_multiple_of(2) {
                [1.0, 0.0]
            } else {
                [0.0, 1.0]
            }
        };
        let before = identities(alternating);
        let smoothed = smoothed(&patch(SIDE), before.clone(), &votes(|_| 1e5)).unwrap();
        for (after, before) in smoothed.scores.iter().zip(&before.scores) {
            assert!((after - before).abs() < 2e-4, "{before} became {after}");
        }
    }

    #[test]
    fn many_votes_reach_the_least_sum() {
        let gaussians = patch(3);
        let own = identities(|i| if i % 3 == 0 { [0.9, 0.1] } else { [0.3, 0.7] });
        let count = |i: usize| 4.0 + (i % 5) as f32;
        let smoothed = smoothed(&gaussians, own.clone(), &votes(count)).unwrap();
        let affinities = SurfaceGraph::new(&gaussians, NEIGHBOURS)
            .unwrap()
            .affinities(DECAY);
        let mut system = DMatrix::<f64>::zeros(N, N);
        let mut right = DMatrix::<f64>::zeros(N, 2);
        for i in 0..N {
            let held = f64::from(OWN + count(i));
            system[(i, i)] += held;
            let (columns, values) = affinities.row(i);
            for (&j, &w) in columns.iter().zip(values) {
                system[(i, i)] += f64::from(w);
                system[(i, j as usize)] -= f64::from(w);
            }
            for class in 0..2 {
                right[(i, class)] = held * f64::from(own.scores[2 * i + class]);
            }
        }
        let least = system.lu().solve(&right).unwrap();
        for i in 0..N {
            for class in 0..2 {
                let found = f64::from(smoothed.scores[2 * i + class]);
                let expected = least[(i, class)];
                assert!((found - expected).abs() < 1e-4, "{i}: {found}, {expected}");
            }
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
