//! Groups that turn out to be two things.
//!
//! A segment that covers two things may come first, and the views that show only one of them then go to its group, where
//! they outweigh those that show both and tell them apart. Weights do not show that; segments side by side do.

use super::asked::{Own, says};
use super::groups::{Groups, Placed};
use super::masks::{Mask, Masks};
use super::merge::DOUBT;
use super::scratch::Zeros;
use super::{End, Look};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Pairs of segments, of those that a group has side by side in a view, from which its parts are grown.
const SEEDS: usize = 6;
/// A segment of which the one part has this much of what the other has is of both.
const MIXED: f64 = 0.25;
/// A part of a group that has less than this share of its Gaussians is nothing by itself: a piece of something else.
const OWN: f64 = 0.5;
/// Passes over the segments of a group in which its two parts settle.
const PASSES: usize = 4;

/// Weights of the two parts of a group on each Gaussian, pixels.
type Parts = [[f32; 2]];

/// Pieces of a group by view and place in the view, in the order in which views are looked at.
type Pieces = Vec<(usize, usize)>;

/// Two pieces of a view, from which two parts grow.
type Seed = [(usize, usize); 2];

/// A group that may be two things.
struct Suspect {
    group: u32,
    pieces: Pieces,
    seeds: Vec<Seed>,
    /// The Gaussians of the group, ascending.
    gaussians: Vec<u32>,
    /// The pieces that leave, and their weight; of several ways to part the group the one with the largest smaller part.
    best: Option<(f64, Pieces)>,
}

/// A way to part a group: the pieces of the smaller part, their weight, and the Gaussians of both parts.
struct Way {
    weight: f64,
    leaving: Pieces,
    parts: Vec<Own>,
}

/// Splits groups that more than the share `1 - above` of the views, one more that does not counted in, take for two; says
/// whether there were any. Of a split group the larger part keeps its number. `groups` has the weights of `placed`. `look` is
/// asked whether to go on.
///
/// The views are asked of one way to part each of the groups at a time: [`SEEDS`] passes over their segments, however many
/// groups there are.
pub(super) fn split<B>(
    groups: &mut Groups,
    views: &[Masks],
    placed: &mut [Placed<'_>],
    order: &[usize],
    above: f64,
    look: &mut Look<'_, B>,
) -> Result<bool, End<B>> {
    let mut suspects = suspects(groups, placed, order);
    let zeros = Zeros::new(groups.owners().len());
    for round in 0..SEEDS {
        look(0)?;
        let way =
            |suspect: &Suspect| way(groups, placed, suspect, *suspect.seeds.get(round)?, &zeros);
        let ways: Vec<Option<Way>> = suspects.par_iter().map(way).collect();
        let ways = suspects
            .iter_mut()
            .zip(ways)
            .filter_map(|(suspect, way)| Some((suspect, way?)));
        let (suspects, ways): (Vec<&mut Suspect>, Vec<Way>) = ways.unzip();
        let parts: Vec<&[Own]> = ways.iter().map(|way| &*way.parts).collect();
        let said = says(groups.owners().len(), views, &parts);
        for ((suspect, way), (one, two)) in suspects.into_iter().zip(ways).zip(said) {
            if above * two > (1.0 - above) * (one + DOUBT) {
                suspect.best = Some((way.weight, way.leaving));
            }
        }
    }
    let mut any = false;
    for Suspect { group, best, .. } in suspects {
        let Some((_, leaving)) = best else { continue };
        let new = groups.open(groups.kind(group));
        leaving
            .into_iter()
            .for_each(|(v, k)| placed[v].groups[k] = Some(new));
        any = true;
    }
    Ok(any)
}

/// The groups of things that have two segments of some view, ascending.
fn suspects(groups: &Groups, placed: &[Placed<'_>], order: &[usize]) -> Vec<Suspect> {
    let mut pieces: BTreeMap<u32, Pieces> = BTreeMap::new();
    for &v in order {
        for (k, group) in placed[v].groups.iter().enumerate() {
            let Some(group) = group.filter(|group| groups.kind(*group).thing) else {
                continue;
            };
            pieces.entry(group).or_default().push((v, k));
        }
    }
    let suspect = |(group, pieces): (u32, Pieces)| {
        let seeds = seeds(placed, &pieces);
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

/// The way to part a group that grows from `seed`, where it would be better than the best one and both parts are things by
/// themselves.
fn way(
    groups: &Groups,
    placed: &[Placed<'_>],
    suspect: &Suspect,
    seed: Seed,
    zeros: &Zeros<[f32; 2]>,
) -> Option<Way> {
    let Suspect {
        pieces,
        gaussians,
        best,
        ..
    } = suspect;
    let mask = |&(v, k): &(usize, usize)| &*placed[v].masks[k];
    let mut parts = zeros.lend();
    let sides = grown(&mut parts, placed, pieces, seed);
    let of_side = |side| {
        pieces
            .iter()
            .zip(&sides)
            .filter(move |(_, s)| **s == side)
            .map(|(piece, _)| *piece)
    };
    let weights = [0, 1].map(|side| of_side(side).map(|piece| mask(&piece).total).sum::<f64>());
    let smaller = usize::from(weights[0] >= weights[1]);
    let improves = best
        .as_ref()
        .is_none_or(|(weight, _)| weights[smaller] > *weight);
    let things = || {
        purity(groups, gaussians, &parts)
            .iter()
            .all(|purity| *purity > OWN)
    };
    let found = (improves && things()).then(|| {
        let parts = owned(groups, gaussians, &parts);
        Way {
            weight: weights[smaller],
            leaving: of_side(smaller).collect(),
            parts,
        }
    });
    pieces
        .iter()
        .flat_map(|piece| &mask(piece).weights)
        .for_each(|(i, _)| parts[*i as usize] = [0.0; 2]);
    found
}

/// The mean of each part's share of all weight on the Gaussians that it covers, some of `gaussians`.
fn purity(groups: &Groups, gaussians: &[u32], parts: &Parts) -> [f64; 2] {
    [0, 1].map(|side| {
        let (mut sum, mut pure) = (0.0, 0.0);
        for &gaussian in gaussians {
            let own = f64::from(parts[gaussian as usize][side]);
            if own > 0.0 {
                sum += own;
                pure += own * own / groups.total(gaussian).max(own);
            }
        }
        if sum > 0.0 { pure / sum } else { 0.0 }
    })
}

/// Of the Gaussians of a group those that one of its parts has; where both do, the one with more.
fn owned(groups: &Groups, gaussians: &[u32], parts: &Parts) -> Vec<Own> {
    let own = |&gaussian: &u32| {
        let [a, b] = parts[gaussian as usize];
        let side = usize::from(b > a);
        let own = f64::from(parts[gaussian as usize][side]);
        (own > 0.0).then(|| Own {
            gaussian,
            side,
            share: own / groups.total(gaussian).max(own),
        })
    };
    gaussians.iter().filter_map(own).collect()
}

/// Pairs of a view's two largest segments in the group, those with the largest second one first.
fn seeds(placed: &[Placed<'_>], pieces: &Pieces) -> Vec<Seed> {
    let total = |(v, k): (usize, usize)| placed[v].masks[k].total;
    let segment = |(v, k): (usize, usize)| placed[v].masks[k].segment.id;
    let mut pairs = Vec::new();
    for of_view in pieces.chunk_by(|a, b| a.0 == b.0) {
        let mut of_view = of_view.to_vec();
        of_view.sort_by(|&a, &b| total(b).total_cmp(&total(a)).then(a.cmp(&b)));
        if let Some(&second) = of_view
            .iter()
            .find(|piece| segment(**piece) != segment(of_view[0]))
        {
            pairs.push([of_view[0], second]);
        }
    }
    pairs.sort_by(|a, b| total(b[1]).total_cmp(&total(a[1])).then(a.cmp(b)));
    pairs.truncate(SEEDS);
    pairs
}

/// Puts into `parts`, which are zero, the two parts that grow from a pair of segments, which stay: each other piece goes to the
/// part that has it, and to neither, in the end to the larger one, where both have some of it. Returns the part of each piece.
fn grown(parts: &mut Parts, placed: &[Placed<'_>], pieces: &Pieces, seed: Seed) -> Vec<usize> {
    let mask = |&(v, k): &(usize, usize)| &*placed[v].masks[k];
    let mut sides: Vec<Option<usize>> = pieces
        .iter()
        .map(|piece| seed.iter().position(|s| s == piece))
        .collect();
    let add = |parts: &mut Parts, mask: &Mask, side: Option<usize>, sign: f32| {
        let Some(side) = side else { return };
        mask.weights
            .iter()
            .for_each(|(i, w)| parts[*i as usize][side] += sign * w);
    };
    pieces
        .iter()
        .zip(&sides)
        .for_each(|(piece, &side)| add(parts, mask(piece), side, 1.0));
    let mut larger = vec![0; pieces.len()];
    for _ in 0..PASSES {
        for ((piece, side), larger) in pieces.iter().zip(&mut sides).zip(&mut larger) {
            if let Some(i) = seed.iter().position(|s| s == piece) {
                *larger = i;
                continue;
            }
            add(parts, mask(piece), *side, -1.0);
            let mut claims = [0.0_f64; 2];
            for &(gaussian, weight) in &mask(piece).weights {
                let [a, b] = parts[gaussian as usize].map(|w| f64::from(w.max(0.0)));
                let share = f64::from(weight) / (a + b + 1.0);
                claims[0] += share * a;
                claims[1] += share * b;
            }
            *larger = usize::from(claims[1] > claims[0]);
            let clear = claims[1 - *larger] < MIXED * claims[*larger];
            *side = clear.then_some(*larger);
            add(parts, mask(piece), *side, 1.0);
        }
    }
    larger
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::groups::Kind;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::borrow::Cow;
    use std::convert::Infallible;

    const KIND: Kind = Kind {
        class: None,
        thing: true,
    };

    /// First Gaussian of a segment and one past its last.
    type Span = (u32, u32);

    /// Views, each with ten pixels on every Gaussian of its segments.
    fn views(of: &[&[Span]]) -> Vec<Masks> {
        let mask = |(id, &(first, end)): (usize, &Span)| Mask {
            segment: Segment {
                id: id as u16 + 1,
                class: None,
                thing: true,
            },
            weights: (first..end).map(|g| (g, 10.0)).collect(),
            total: 10.0 * f64::from(end - first),
        };
        of.iter()
            .map(|view| Masks {
                segments: view.iter().enumerate().map(mask).collect(),
                rest: Vec::new(),
            })
            .collect()
    }

    /// Whether anything was split.
    fn whether(split: Result<bool, End<Infallible>>) -> bool {
        match split {
            Ok(any) => any,
            Err(End::Failed(error)) => panic!("{error}"),
            Err(End::Told(never)) => match never {},
        }
    }

    /// Whether anything was split, and the groups of each view's segments after all of them were one group.
    fn parted(views: &[Masks]) -> (bool, Vec<Vec<u32>>) {
        let mut groups = Groups::new(20);
        let only = groups.open(KIND);
        let mut placed: Vec<Placed<'_>> = views
            .iter()
            .map(|view| Placed {
                masks: view.segments.iter().map(Cow::Borrowed).collect(),
                groups: vec![Some(only); view.segments.len()],
            })
            .collect();
        placed.iter().for_each(|view| groups.add(view));
        let order: Vec<usize> = (0..views.len()).collect();
        let any = whether(split(
            &mut groups,
            views,
            &mut placed,
            &order,
            0.5,
            &mut |_| Ok(()),
        ));
        (
            any,
            placed
                .iter()
                .map(|view| view.groups.iter().map(|g| g.expect("placed")).collect())
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
        let [one, other] = [groups.open(KIND), groups.open(KIND)];
        let mut placed: Vec<Placed<'_>> = views
            .iter()
            .map(|view| Placed {
                masks: view.segments.iter().map(Cow::Borrowed).collect(),
                groups: vec![Some(one); 2],
            })
            .collect();
        placed.iter().for_each(|view| groups.add(view));
        let heavy = Mask {
            weights: vec![(0, 1e3), (1, 1e3)],
            total: 2e3,
            ..views[0].segments[1].clone()
        };
        groups.add(&Placed {
            masks: vec![Cow::Owned(heavy)],
            groups: vec![Some(other)],
        });
        assert!(!whether(split(
            &mut groups,
            &views,
            &mut placed,
            &[0, 1, 2],
            0.5,
            &mut |_| Ok(())
        )));
    }

    /// The pieces that leave each group, found for one group after the other, by vectors of all Gaussians made anew.
    fn one_by_one(
        groups: &Groups,
        views: &[Masks],
        placed: &[Placed<'_>],
        order: &[usize],
    ) -> Vec<Option<Pieces>> {
        let all: Vec<u32> = (0..groups.owners().len() as u32).collect();
        let leaving = |suspect: Suspect| {
            let mask = |&(v, k): &(usize, usize)| &*placed[v].masks[k];
            let mut best: Option<(f64, Pieces)> = None;
            for &seed in &suspect.seeds {
                let mut parts = vec![[0.0; 2]; all.len()];
                let sides = grown(&mut parts, placed, &suspect.pieces, seed);
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
                    && purity(groups, &all, &parts)
                        .iter()
                        .all(|purity| *purity > OWN)
                {
                    let said = says(all.len(), views, &[&owned(groups, &all, &parts)]);
                    if said[0].1 > said[0].0 + DOUBT {
                        best = Some((weights[smaller], of_side(smaller).collect()));
                    }
                }
            }
            best.map(|(_, leaving)| leaving)
        };
        suspects(groups, placed, order)
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
            (0..3).for_each(|group| assert_eq!(groups.open(KIND), group));
            let placed = views.iter().zip(of);
            let placed = placed.map(|(view, groups)| Placed {
                masks: view.segments.iter().map(Cow::Borrowed).collect(),
                groups,
            });
            let mut placed: Vec<Placed<'_>> = placed.collect();
            placed.iter().for_each(|view| groups.add(view));
            let order: Vec<usize> = (0..views.len()).rev().collect();
            let leaving = one_by_one(&groups, &views, &placed, &order);
            let mut want: Vec<Vec<Option<u32>>> =
                placed.iter().map(|view| view.groups.clone()).collect();
            let found: Vec<&Pieces> = leaving.iter().flatten().collect();
            for (new, pieces) in (3..).zip(&found) {
                pieces.iter().for_each(|&(v, k)| want[v][k] = Some(new));
            }
            let any = whether(split(
                &mut groups,
                &views,
                &mut placed,
                &order,
                0.5,
                &mut |_| Ok(()),
            ));
            assert_eq!(any, !found.is_empty());
            assert!(placed.iter().map(|view| &view.groups).eq(&want));
            splits += found.len();
            stay += leaving.len() - found.len();
        }
        assert!(splits > 10 && stay > 10, "{splits} split, {stay} not");
    }
}
