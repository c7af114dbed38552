//! What the views say of several pairs of parts, in one pass over their segments.

use super::ownership::{Evidence, evidence, extents, sightings};
use super::segments::ViewSegments;
use super::sums::SparseSums;
use rayon::prelude::*;

/// A Gaussian of one of two parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct PartGaussian {
    pub gaussian: u32,
    /// The part with more weight on it, 0 or 1.
    pub side: u32,
    /// The share of that part in the weight of all groups.
    pub share: f64,
}

/// The evidence of the views on each pair of parts. Other pairs beside it change nothing, to the last bit.
pub(super) fn part_evidence(
    gaussians: usize,
    views: &[ViewSegments],
    pairs: &[&[PartGaussian]],
) -> Vec<Evidence> {
    if pairs.is_empty() {
        return Vec::new();
    }
    // For each Gaussian the parts that have it.
    let mut parts_of: Vec<Vec<(u32, f64)>> = vec![Vec::new(); gaussians];
    for (pair, parts) in (0..).zip(pairs) {
        for part in *parts {
            parts_of[part.gaussian as usize].push((2 * pair + part.side, part.share));
        }
    }
    let sets = 2 * pairs.len();
    let views: Vec<_> = views
        .par_iter()
        .map_init(
            || SparseSums::new(sets),
            |sums, view| {
                sightings(view, sums, |gaussian, weight| {
                    let sets = parts_of[gaussian as usize].iter();
                    sets.map(move |&(set, share)| (set, weight * share))
                })
            },
        )
        .collect();
    let extents = extents(sets, &views);
    (0..pairs.len() as u32)
        .map(|pair| evidence(&views, &extents, [2 * pair, 2 * pair + 1]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::segments::SegmentWeights;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const GAUSSIANS: usize = 90;

    /// What the views say of one pair of parts, by looking at all that every view shows.
    fn alone(views: &[ViewSegments], parts: &[PartGaussian]) -> Evidence {
        let mut owns = [None; GAUSSIANS];
        parts
            .iter()
            .for_each(|own| owns[own.gaussian as usize] = Some(own));
        let share = |weights: &[(u32, f32)]| {
            let mut shown = [0.0_f64; 2];
            for &(gaussian, weight) in weights {
                if let Some(own) = owns[gaussian as usize] {
                    shown[own.side as usize] += f64::from(weight) * own.share;
                }
            }
            shown
        };
        /// Pixels in the view, and the segment that covers the part.
        type Part = (f64, Option<usize>);
        let places: Vec<[Part; 2]> = views
            .iter()
            .map(|view| {
                let segments = view.segments.iter();
                let shown: Vec<[f64; 2]> = segments.map(|s| share(&s.weights)).collect();
                let rest = share(&view.unlabelled);
                [0, 1].map(|side| {
                    let labelled: f64 = shown.iter().map(|shown| shown[side]).sum();
                    let total = labelled + rest[side];
                    let covers = |s: &[f64; 2]| s[side] > 0.5 * labelled && s[side] > 0.25 * total;
                    (total, shown.iter().position(covers))
                })
            })
            .collect();
        let most = [0, 1].map(|side| places.iter().map(|p| p[side].0).fold(0.0, f64::max));
        let mut evidence = Evidence::default();
        for [a, b] in places {
            if let (Some(in_a), Some(in_b)) = (a.1, b.1) {
                let weight = ((a.0 / most[0]).min(b.0 / most[1]) / 0.1).min(1.0);
                *(if in_a == in_b {
                    &mut evidence.one
                } else {
                    &mut evidence.two
                }) += weight;
            }
        }
        evidence
    }

    /// Weights of some of the Gaussians of a span, which may reach beyond the last one.
    fn some(rng: &mut ChaCha8Rng, first: usize, count: usize) -> Vec<(u32, f32)> {
        let weight =
            |g: usize| (rng.random_bool(0.8)).then_some((g as u32, rng.random_range(0.01..30.0)));
        (first..(first + count).min(GAUSSIANS))
            .filter_map(weight)
            .collect()
    }

    #[test]
    fn pairs_together_have_the_evidence_of_each_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut ones = 0;
        let mut twos = 0;
        for _ in 0..30 {
            let mut views = vec![ViewSegments::default()];
            for _ in 0..8 {
                let mut segments = Vec::new();
                for id in 1..rng.random_range(2..7) {
                    let first = rng.random_range(0..GAUSSIANS);
                    let count = rng.random_range(0..50);
                    let weights = some(&mut rng, first, count);
                    segments.push(SegmentWeights {
                        segment: Segment {
                            id,
                            class: None,
                            thing: true,
                        },
                        weights,
                        total: 0.0,
                    });
                }
                let rest = rng.random_range(0..GAUSSIANS);
                views.push(ViewSegments {
                    segments,
                    unlabelled: some(&mut rng, rest, 20),
                });
            }
            // Parts lie side by side and over those of other pairs; one pair has nothing.
            let mut pairs: Vec<Vec<PartGaussian>> = vec![Vec::new()];
            for _ in 0..6 {
                let first = rng.random_range(0..GAUSSIANS);
                let border = rng.random_range(0..25);
                let parts = some(&mut rng, first, 40)
                    .into_iter()
                    .map(|(gaussian, weight)| {
                        let side = u32::from(gaussian as usize > first + border);
                        PartGaussian {
                            gaussian,
                            side,
                            share: f64::from(weight) / 31.0,
                        }
                    });
                pairs.push(parts.collect());
            }
            let slices: Vec<&[PartGaussian]> = pairs.iter().map(|parts| &**parts).collect();
            let bits = |evidence: Evidence| [evidence.one, evidence.two].map(f64::to_bits);
            let together = part_evidence(GAUSSIANS, &views, &slices);
            let each: Vec<Evidence> = pairs.iter().map(|parts| alone(&views, parts)).collect();
            assert!(
                together
                    .iter()
                    .copied()
                    .map(bits)
                    .eq(each.iter().copied().map(bits)),
                "{together:?} {each:?}"
            );
            ones += each.iter().filter(|evidence| evidence.one > 0.0).count();
            twos += each.iter().filter(|evidence| evidence.two > 0.0).count();
        }
        assert!(
            ones > 10 && twos > 10,
            "{ones} and {twos} of 180 pairs are one and two to some view"
        );
        assert!(part_evidence(GAUSSIANS, &[ViewSegments::default()], &[]).is_empty());
    }
}
