//! Groups that turn out to be two objects.
//!
//! A segment that covers two objects may come first. The views that show only one of them then join its group. There they outweigh
//! the views that tell them apart. Weights do not show that; segments side by side do.

mod candidates;
mod partition;

use super::Progress;
use super::groups::{Assigned, Groups};
use super::merge::{MIN_AGREEMENT, PRIOR_VIEWS};
use super::ownership::Evidence;
use super::part_evidence::{PartGaussian, part_evidence};
use super::segments::ViewSegments;
use crate::error::Result;
use candidates::{Candidate, SEEDS, candidates};
use partition::{Partition, partition};
use rayon::prelude::*;

/// Splits each group that the views take for two objects. Returns whether any group was split. More than the share `1 -
/// MIN_AGREEMENT` of the views that count must say two, and [`PRIOR_VIEWS`] views say one beforehand. The larger part keeps the
/// number of the group. `groups` has the weights of `assigned`. Asks `progress` whether to go on.
///
/// One pass over the views compares a partition of every group, so there are [`SEEDS`] passes whatever the number of groups.
pub(super) fn split(
    groups: &mut Groups,
    views: &[ViewSegments],
    assigned: &mut [Assigned<'_>],
    order: &[usize],
    progress: &mut Progress,
) -> Result<bool> {
    let mut candidates = candidates(groups, assigned, order);
    let gaussians = groups.owners().len();
    for round in 0..SEEDS {
        progress(0)?;
        let found: Vec<Option<Partition>> = candidates
            .par_iter()
            .map_init(
                || vec![[0.0; 2]; gaussians],
                |parts, candidate| {
                    let seed = candidate.seeds.get(round)?;
                    partition(groups, assigned, candidate, *seed, parts)
                },
            )
            .collect();
        let (candidates, found): (Vec<&mut Candidate>, Vec<Partition>) = candidates
            .iter_mut()
            .zip(found)
            .filter_map(|(candidate, found)| Some((candidate, found?)))
            .unzip();
        let parts: Vec<&[PartGaussian]> = found.iter().map(|found| &*found.parts).collect();
        let evidence = part_evidence(gaussians, views, &parts);
        for ((candidate, found), Evidence { one, two }) in
            candidates.into_iter().zip(found).zip(evidence)
        {
            if MIN_AGREEMENT * two > (1.0 - MIN_AGREEMENT) * (one + PRIOR_VIEWS) {
                candidate.best = Some(found.smaller);
            }
        }
    }
    let mut any = false;
    for Candidate { group, best, .. } in candidates {
        let Some(leaving) = best else { continue };
        let new = groups.create(groups.category(group));
        for (view, index) in leaving.pieces {
            assigned[view].groups[index] = Some(new);
        }
        any = true;
    }
    Ok(any)
}

#[cfg(test)]
mod tests {
    use super::candidates::Piece;
    use super::partition::{MIN_PURITY, grow, part_gaussians, purity};
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::groups::Category;
    use crate::objects::association::segments::SegmentWeights;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::borrow::Cow;

    const CATEGORY: Category = Category {
        class: None,
        thing: true,
    };

    /// First Gaussian of a segment and one past its last.
    type Span = (u32, u32);

    /// Views, each with ten pixels on every Gaussian of its segments.
    fn views(of: &[&[Span]]) -> Vec<ViewSegments> {
        let segment = |(id, &(first, end)): (usize, &Span)| SegmentWeights {
            segment: Segment {
                id: id as u16 + 1,
                class: None,
                thing: true,
            },
            weights: (first..end).map(|g| (g, 10.0)).collect(),
            total: 10.0 * f64::from(end - first),
        };
        of.iter()
            .map(|view| ViewSegments {
                segments: view.iter().enumerate().map(segment).collect(),
                unlabelled: Vec::new(),
            })
            .collect()
    }

    /// Whether anything was split, and the groups of each view's segments after all of them were one group.
    fn parted(views: &[ViewSegments]) -> (bool, Vec<Vec<u32>>) {
        let mut groups = Groups::new(20);
        let only = groups.create(CATEGORY);
        let mut assigned: Vec<Assigned<'_>> = views
            .iter()
            .map(|view| Assigned {
                pieces: view.segments.iter().map(Cow::Borrowed).collect(),
                groups: vec![Some(only); view.segments.len()],
            })
            .collect();
        assigned.iter().for_each(|view| groups.add(view));
        let order: Vec<usize> = (0..views.len()).collect();
        let any = split(&mut groups, views, &mut assigned, &order, &mut |_| Ok(()));
        (
            any.expect("nothing ends it"),
            assigned
                .iter()
                .map(|view| view.groups.iter().map(|g| g.expect("assigned")).collect())
                .collect(),
        )
    }

    #[test]
    fn two_things_that_one_view_joins_are_parted() {
        let apart: &[Span] = &[(0, 12), (12, 20)];
        let (any, groups) = parted(&views(&[
            &[(0, 20)],
            apart,
            apart,
            apart,
            &[(0, 12)],
            &[(12, 20)],
        ]));
        assert!(any);
        // The larger part keeps its number, and the segment of both stays there.
        assert_eq!(
            groups,
            [
                vec![0],
                vec![0, 1],
                vec![0, 1],
                vec![0, 1],
                vec![0],
                vec![1]
            ]
        );
    }

    #[test]
    fn one_thing_that_few_views_cut_stays_one() {
        let cut: &[Span] = &[(0, 12), (12, 20)];
        let whole: &[Span] = &[(0, 20)];
        let (any, groups) = parted(&views(&[whole, whole, whole, cut, cut]));
        assert!(!any);
        assert!(groups.iter().flatten().all(|&g| g == 0), "{groups:?}");
        // Nor does one view alone part what no view joins: `PRIOR_VIEWS` is one view. Two do.
        assert!(!parted(&views(&[&[(0, 12)], &[(12, 20)], cut])).0);
        assert!(parted(&views(&[&[(0, 12)], &[(12, 20)], cut, cut])).0);
    }

    #[test]
    fn a_sliver_of_something_else_is_no_part() {
        // Gaussians 0 and 1 belong to a much heavier group of their own.
        let views = views(&[&[(2, 20), (0, 2)], &[(2, 20), (0, 2)], &[(2, 20), (0, 2)]]);
        let mut groups = Groups::new(20);
        let [one, other] = [groups.create(CATEGORY), groups.create(CATEGORY)];
        let mut assigned: Vec<Assigned<'_>> = views
            .iter()
            .map(|view| Assigned {
                pieces: view.segments.iter().map(Cow::Borrowed).collect(),
                groups: vec![Some(one); 2],
            })
            .collect();
        assigned.iter().for_each(|view| groups.add(view));
        let heavy = SegmentWeights {
            weights: vec![(0, 1e3), (1, 1e3)],
            total: 2e3,
            ..views[0].segments[1].clone()
        };
        groups.add(&Assigned {
            pieces: vec![Cow::Owned(heavy)],
            groups: vec![Some(other)],
        });
        let any = split(&mut groups, &views, &mut assigned, &[0, 1, 2], &mut |_| {
            Ok(())
        });
        assert!(!any.expect("nothing ends it"));
    }

    /// The pieces that leave each group, found for one group after the other, with new vectors over all Gaussians for each.
    fn one_by_one(
        groups: &Groups,
        views: &[ViewSegments],
        assigned: &[Assigned<'_>],
        order: &[usize],
    ) -> Vec<Option<Vec<Piece>>> {
        let all: Vec<u32> = (0..groups.owners().len() as u32).collect();
        let leaving = |candidate: Candidate| {
            let piece = |&(v, k): &(usize, usize)| &*assigned[v].pieces[k];
            let mut best: Option<(f64, Vec<Piece>)> = None;
            for &seed in &candidate.seeds {
                let mut parts = vec![[0.0; 2]; all.len()];
                let sides = grow(&mut parts, assigned, &candidate.pieces, seed);
                let pieces = candidate.pieces.iter().zip(&sides);
                let of_side = |side| {
                    pieces
                        .clone()
                        .filter(move |(_, s)| **s == side)
                        .map(|(piece, _)| *piece)
                };
                let weights =
                    [0, 1].map(|side| of_side(side).map(|p| piece(&p).total).sum::<f64>());
                let smaller = usize::from(weights[0] >= weights[1]);
                let improves = best
                    .as_ref()
                    .is_none_or(|(weight, _)| weights[smaller] > *weight);
                if improves
                    && [0, 1]
                        .iter()
                        .all(|&side| purity(groups, &all, &parts, side) > MIN_PURITY)
                {
                    let parts = part_gaussians(groups, &all, &parts);
                    let evidence = part_evidence(all.len(), views, &[&parts]);
                    if evidence[0].two > evidence[0].one + PRIOR_VIEWS {
                        best = Some((weights[smaller], of_side(smaller).collect()));
                    }
                }
            }
            best.map(|(_, leaving)| leaving)
        };
        candidates(groups, assigned, order)
            .into_iter()
            .map(leaving)
            .collect()
    }

    #[test]
    fn groups_are_split_together_as_one_by_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let mut splits = 0;
        let mut stay = 0;
        for _ in 0..40 {
            // Three groups of two halves each, which views join, part, or show one of; borders between them are blurred.
            let mut spans: Vec<Vec<Span>> = Vec::new();
            let mut of: Vec<Vec<Option<u32>>> = Vec::new();
            for _ in 0..9 {
                let mut view = Vec::new();
                let mut belongs = Vec::new();
                for group in 0..3 {
                    let first = 20 * group;
                    let mut blurred = |at: u32| at + rng.random_range(0..3);
                    let [from, middle, to] =
                        [blurred(first), blurred(first + 10), blurred(first + 20)];
                    let halves: &[Span] = match rng.random_range(0..5) {
                        0 => &[(from, to)],
                        1 => &[(from, middle)],
                        2 => &[(middle, to)],
                        _ => &[(from, middle), (middle, to)],
                    };
                    view.extend_from_slice(halves);
                    belongs.extend(halves.iter().map(|_| Some(group)));
                }
                spans.push(view);
                of.push(belongs);
            }
            let views = views(&spans.iter().map(|view| &**view).collect::<Vec<_>>());
            let mut groups = Groups::new(62);
            (0..3).for_each(|group| assert_eq!(groups.create(CATEGORY), group));
            let assigned = views.iter().zip(of);
            let assigned = assigned.map(|(view, groups)| Assigned {
                pieces: view.segments.iter().map(Cow::Borrowed).collect(),
                groups,
            });
            let mut assigned: Vec<Assigned<'_>> = assigned.collect();
            assigned.iter().for_each(|view| groups.add(view));
            let order: Vec<usize> = (0..views.len()).rev().collect();
            let leaving = one_by_one(&groups, &views, &assigned, &order);
            let mut want: Vec<Vec<Option<u32>>> =
                assigned.iter().map(|view| view.groups.clone()).collect();
            let found: Vec<&Vec<Piece>> = leaving.iter().flatten().collect();
            for (new, pieces) in (3..).zip(&found) {
                pieces.iter().for_each(|&(v, k)| want[v][k] = Some(new));
            }
            let any = split(&mut groups, &views, &mut assigned, &order, &mut |_| Ok(()));
            assert_eq!(any.expect("nothing ends it"), !found.is_empty());
            assert!(assigned.iter().map(|view| &view.groups).eq(&want));
            splits += found.len();
            stay += leaving.len() - found.len();
        }
        assert!(splits > 10 && stay > 10, "{splits} split, {stay} not");
    }
}
