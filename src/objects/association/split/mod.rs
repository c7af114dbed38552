//! Groups that turn out to be two objects.
//!
//! A segment that covers two objects may come first. The views that show only one of them then join its group, where they
//! outweigh the views that show both and tell them apart. Weights do not show that; segments side by side do.

mod partition;

use super::groups::{Assigned, Groups};
use super::merge::DOUBT;
use super::ownership::Evidence;
use super::pair_evidence::{PartGaussian, pair_evidence};
use super::segments::{SegmentWeights, ViewSegments};
use super::{End, Progress};
use partition::{Partition, partition};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Pairs of segments from which the parts of a group are grown, at most.
const SEEDS: usize = 6;

/// A piece of a group: its view, and its place in the view.
type Piece = (usize, usize);

/// Two pieces of a view, from which two parts grow.
type Seed = [Piece; 2];

/// A group that may be two objects.
struct Suspect {
    group: u32,
    /// In the order of the views.
    pieces: Vec<Piece>,
    seeds: Vec<Seed>,
    /// The Gaussians of the group, ascending.
    gaussians: Vec<u32>,
    /// The smaller part of the best partition so far: the one whose smaller part is largest.
    best: Option<SmallerPart>,
}

/// The pieces that leave a group, and their weight.
struct SmallerPart {
    weight: f64,
    pieces: Vec<Piece>,
}

/// Splits each group that the views take for two objects, and returns whether there is one: more than the share `1 - above` of
/// the views that count, with [`DOUBT`] more for one object, must say two. The larger part keeps the number of the group.
/// `groups` has the weights of `assigned`. Asks `progress` whether to go on.
///
/// One pass over the views compares a partition of every group, so there are [`SEEDS`] passes whatever the number of groups.
pub(super) fn split(
    groups: &mut Groups,
    views: &[ViewSegments],
    assigned: &mut [Assigned<'_>],
    order: &[usize],
    above: f64,
    progress: &mut Progress,
) -> Result<bool, End> {
    let mut suspects = suspects(groups, assigned, order);
    let gaussians = groups.owners().len();
    for round in 0..SEEDS {
        progress(0)?;
        let found: Vec<Option<Partition>> = suspects
            .par_iter()
            .map_init(
                || vec![[0.0; 2]; gaussians],
                |parts, suspect| {
                    let seed = suspect.seeds.get(round)?;
                    partition(groups, assigned, suspect, *seed, parts)
                },
            )
            .collect();
        let (suspects, found): (Vec<&mut Suspect>, Vec<Partition>) = suspects
            .iter_mut()
            .zip(found)
            .filter_map(|(suspect, found)| Some((suspect, found?)))
            .unzip();
        let parts: Vec<&[PartGaussian]> = found.iter().map(|found| &*found.parts).collect();
        let evidence = pair_evidence(gaussians, views, &parts);
        for ((suspect, found), Evidence { one, two }) in
            suspects.into_iter().zip(found).zip(evidence)
        {
            if above * two > (1.0 - above) * (one + DOUBT) {
                suspect.best = Some(found.smaller);
            }
        }
    }
    let mut any = false;
    for Suspect { group, best, .. } in suspects {
        let Some(leaving) = best else { continue };
        let new = groups.open(groups.category(group));
        for (view, place) in leaving.pieces {
            assigned[view].groups[place] = Some(new);
        }
        any = true;
    }
    Ok(any)
}

/// The groups of things that have two segments of some view, ascending.
fn suspects(groups: &Groups, assigned: &[Assigned<'_>], order: &[usize]) -> Vec<Suspect> {
    let mut pieces: BTreeMap<u32, Vec<Piece>> = BTreeMap::new();
    for &view in order {
        for (place, group) in assigned[view].groups.iter().enumerate() {
            if let Some(group) = group.filter(|group| groups.category(*group).thing) {
                pieces.entry(group).or_default().push((view, place));
            }
        }
    }
    let suspect = |(group, pieces): (u32, Vec<Piece>)| {
        let seeds = seeds(assigned, &pieces);
        (!seeds.is_empty()).then(|| Suspect {
            group,
            pieces,
            seeds,
            gaussians: Vec::new(),
            best: None,
        })
    };
    let mut suspects: Vec<Suspect> = pieces.into_iter().filter_map(suspect).collect();
    for (gaussian, owners) in (0..).zip(groups.owners()) {
        for (group, _) in owners {
            if let Ok(i) = suspects.binary_search_by_key(group, |suspect| suspect.group) {
                suspects[i].gaussians.push(gaussian);
            }
        }
    }
    suspects
}

fn weights<'a>(assigned: &'a [Assigned<'_>], (view, place): Piece) -> &'a SegmentWeights {
    &assigned[view].pieces[place]
}

/// The pairs of a view's two largest segments in the group, those with the largest second one first.
fn seeds(assigned: &[Assigned<'_>], pieces: &[Piece]) -> Vec<Seed> {
    let total = |piece: Piece| weights(assigned, piece).total;
    let segment = |piece: Piece| weights(assigned, piece).segment.id;
    let mut pairs = Vec::new();
    for of_view in pieces.chunk_by(|a, b| a.0 == b.0) {
        let mut of_view = of_view.to_vec();
        of_view.sort_by(|&a, &b| total(b).total_cmp(&total(a)).then(a.cmp(&b)));
        let first = of_view[0];
        let other = of_view
            .iter()
            .find(|piece| segment(**piece) != segment(first));
        pairs.extend(other.map(|&second| [first, second]));
    }
    pairs.sort_by(|a, b| total(b[1]).total_cmp(&total(a[1])).then(a.cmp(b)));
    pairs.truncate(SEEDS);
    pairs
}

#[cfg(test)]
mod tests {
    use super::partition::{OWN, grow, part_gaussians, purity};
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::groups::Category;
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
        let mask = |(id, &(first, end)): (usize, &Span)| SegmentWeights {
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
                segments: view.iter().enumerate().map(mask).collect(),
                unlabelled: Vec::new(),
            })
            .collect()
    }

    /// Whether anything was split.
    fn whether(split: Result<bool, End>) -> bool {
        split.map_err(|_| "ended").expect("nothing ends it")
    }

    /// Whether anything was split, and the groups of each view's segments after all of them were one group.
    fn parted(views: &[ViewSegments]) -> (bool, Vec<Vec<u32>>) {
        let mut groups = Groups::new(20);
        let only = groups.open(CATEGORY);
        let mut assigned: Vec<Assigned<'_>> = views
            .iter()
            .map(|view| Assigned {
                pieces: view.segments.iter().map(Cow::Borrowed).collect(),
                groups: vec![Some(only); view.segments.len()],
            })
            .collect();
        assigned.iter().for_each(|view| groups.add(view));
        let order: Vec<usize> = (0..views.len()).collect();
        let any = whether(split(
            &mut groups,
            views,
            &mut assigned,
            &order,
            0.5,
            &mut |_| Ok(()),
        ));
        (
            any,
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
        // Nor does one view alone part what no view joins: `DOUBT` is one view. Two do.
        assert!(!parted(&views(&[&[(0, 12)], &[(12, 20)], cut])).0);
        assert!(parted(&views(&[&[(0, 12)], &[(12, 20)], cut, cut])).0);
    }

    #[test]
    fn a_sliver_of_something_else_is_no_part() {
        // Gaussians 0 and 1 belong to a much heavier group of their own.
        let views = views(&[&[(2, 20), (0, 2)], &[(2, 20), (0, 2)], &[(2, 20), (0, 2)]]);
        let mut groups = Groups::new(20);
        let [one, other] = [groups.open(CATEGORY), groups.open(CATEGORY)];
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
        assert!(!whether(split(
            &mut groups,
            &views,
            &mut assigned,
            &[0, 1, 2],
            0.5,
            &mut |_| Ok(())
        )));
    }

    /// The pieces that leave each group, found for one group after the other, by vectors of all Gaussians made anew.
    fn one_by_one(
        groups: &Groups,
        views: &[ViewSegments],
        assigned: &[Assigned<'_>],
        order: &[usize],
    ) -> Vec<Option<Vec<Piece>>> {
        let all: Vec<u32> = (0..groups.owners().len() as u32).collect();
        let leaving = |suspect: Suspect| {
            let mask = |&(v, k): &(usize, usize)| &*assigned[v].pieces[k];
            let mut best: Option<(f64, Vec<Piece>)> = None;
            for &seed in &suspect.seeds {
                let mut parts = vec![[0.0; 2]; all.len()];
                let sides = grow(&mut parts, assigned, &suspect.pieces, seed);
                let pieces = suspect.pieces.iter().zip(&sides);
                let of_side = |side| {
                    pieces
                        .clone()
                        .filter(move |(_, s)| **s == side)
                        .map(|(piece, _)| *piece)
                };
                let weights =
                    [0, 1].map(|side| of_side(side).map(|piece| mask(&piece).total).sum::<f64>());
                let smaller = usize::from(weights[0] >= weights[1]);
                let improves = best
                    .as_ref()
                    .is_none_or(|(weight, _)| weights[smaller] > *weight);
                if improves
                    && [0, 1]
                        .iter()
                        .all(|&side| purity(groups, &all, &parts, side) > OWN)
                {
                    let parts = part_gaussians(groups, &all, &parts);
                    let evidence = pair_evidence(all.len(), views, &[&parts]);
                    if evidence[0].two > evidence[0].one + DOUBT {
                        best = Some((weights[smaller], of_side(smaller).collect()));
                    }
                }
            }
            best.map(|(_, leaving)| leaving)
        };
        suspects(groups, assigned, order)
            .into_iter()
            .map(leaving)
            .collect()
    }

    #[test]
    fn groups_are_split_together_as_one_by_one() {
        let (mut rng, mut splits, mut stay) = (ChaCha8Rng::seed_from_u64(8), 0, 0);
        for _ in 0..40 {
            // Three groups of two halves each, which views join, part, or show one of; borders between them are blurred.
            let mut spans: Vec<Vec<Span>> = Vec::new();
            let mut of: Vec<Vec<Option<u32>>> = Vec::new();
            for _ in 0..9 {
                let (mut view, mut belongs) = (Vec::new(), Vec::new());
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
            (0..3).for_each(|group| assert_eq!(groups.open(CATEGORY), group));
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
            let any = whether(split(
                &mut groups,
                &views,
                &mut assigned,
                &order,
                0.5,
                &mut |_| Ok(()),
            ));
            assert_eq!(any, !found.is_empty());
            assert!(assigned.iter().map(|view| &view.groups).eq(&want));
            splits += found.len();
            stay += leaving.len() - found.len();
        }
        assert!(splits > 10 && stay > 10, "{splits} split, {stay} not");
    }
}
