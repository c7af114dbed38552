//! Groups that turn out to be two things.
//!
//! A segment that covers two things may come first, and the views that show only one of them then go to its group, where
//! they outweigh those that show both and tell them apart. Weights do not show that; segments side by side do.

use super::groups::{Groups, Placed};
use super::masks::{Mask, Masks};
use super::merge::{DOUBT, say};
use super::territory::{Places, covering};
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
type Parts = Vec<[f32; 2]>;

/// Pieces of a group by view and place in the view, in the order in which views are looked at.
type Pieces = Vec<(usize, usize)>;

/// Splits groups that more than the share `1 - above` of the views, one more that does not counted in, take for two; says
/// whether there were any. Of a split group the larger part keeps its number.
pub(super) fn split(
    groups: &mut Groups,
    views: &[Masks],
    placed: &mut [Placed<'_>],
    order: &[usize],
    above: f64,
) -> bool {
    let mut pieces: BTreeMap<u32, Pieces> = BTreeMap::new();
    for &v in order {
        for (k, group) in placed[v].groups.iter().enumerate() {
            let Some(group) = group.filter(|group| groups.kind(*group).thing) else { continue };
            pieces.entry(group).or_default().push((v, k));
        }
    }
    let pieces: Vec<(u32, Pieces)> = pieces.into_iter().collect();
    let leaving: Vec<Option<Pieces>> =
        pieces.par_iter().map(|(_, pieces)| part(groups, views, placed, pieces, above)).collect();
    let mut any = false;
    for ((group, _), leaving) in pieces.iter().zip(leaving) {
        let Some(leaving) = leaving else { continue };
        let new = groups.open(groups.kind(*group));
        leaving.into_iter().for_each(|(v, k)| placed[v].groups[k] = Some(new));
        any = true;
    }
    any
}

/// The pieces that leave a group, where it is two things. Of several ways to part it the one with the largest smaller part.
fn part(groups: &Groups, views: &[Masks], placed: &[Placed<'_>], pieces: &Pieces, above: f64) -> Option<Pieces> {
    let mask = |&(v, k): &(usize, usize)| &*placed[v].masks[k];
    let mut best: Option<(f64, Pieces)> = None;
    for seed in seeds(placed, pieces) {
        let (parts, sides) = grown(groups, placed, pieces, seed);
        let of_side = |side| pieces.iter().zip(&sides).filter(move |(_, s)| **s == side).map(|(piece, _)| *piece);
        let weights = [0, 1].map(|side| of_side(side).map(|piece| mask(&piece).total).sum::<f64>());
        let smaller = usize::from(weights[0] >= weights[1]);
        let improves = best.as_ref().is_none_or(|(weight, _)| weights[smaller] > *weight);
        if improves && purity(groups, &parts).iter().all(|purity| *purity > OWN) {
            let (one, two) = says(groups, views, &parts);
            if above * two > (1.0 - above) * (one + DOUBT) {
                best = Some((weights[smaller], of_side(smaller).collect()));
            }
        }
    }
    best.map(|(_, leaving)| leaving)
}

/// The mean of each part's share of all weight on the Gaussians that it covers.
fn purity(groups: &Groups, parts: &Parts) -> [f64; 2] {
    [0, 1].map(|side| {
        let (mut sum, mut pure) = (0.0, 0.0);
        for (part, owners) in parts.iter().zip(groups.owners()).filter(|(part, _)| part[side] > 0.0) {
            let all: f64 = owners.iter().map(|(_, w)| f64::from(*w)).sum();
            let own = f64::from(part[side]);
            sum += own;
            pure += own * own / all.max(own);
        }
        if sum > 0.0 { pure / sum } else { 0.0 }
    })
}

/// Pairs of a view's two largest segments in the group, those with the largest second one first.
fn seeds(placed: &[Placed<'_>], pieces: &Pieces) -> Vec<[(usize, usize); 2]> {
    let total = |(v, k): (usize, usize)| placed[v].masks[k].total;
    let segment = |(v, k): (usize, usize)| placed[v].masks[k].segment.id;
    let mut pairs = Vec::new();
    for of_view in pieces.chunk_by(|a, b| a.0 == b.0) {
        let mut of_view = of_view.to_vec();
        of_view.sort_by(|&a, &b| total(b).total_cmp(&total(a)).then(a.cmp(&b)));
        if let Some(&second) = of_view.iter().find(|piece| segment(**piece) != segment(of_view[0])) {
            pairs.push([of_view[0], second]);
        }
    }
    pairs.sort_by(|a, b| total(b[1]).total_cmp(&total(a[1])).then(a.cmp(b)));
    pairs.truncate(SEEDS);
    pairs
}

/// The two parts that grow from a pair of segments, which stay: each other piece goes to the part that has it, and to
/// neither, in the end to the larger one, where both have some of it. And the part of each piece.
fn grown(groups: &Groups, placed: &[Placed<'_>], pieces: &Pieces, seed: [(usize, usize); 2]) -> (Parts, Vec<usize>) {
    let mut parts: Parts = vec![[0.0; 2]; groups.owners().len()];
    let mask = |&(v, k): &(usize, usize)| &*placed[v].masks[k];
    let mut sides: Vec<Option<usize>> = pieces.iter().map(|piece| seed.iter().position(|s| s == piece)).collect();
    let add = |parts: &mut Parts, mask: &Mask, side: Option<usize>, sign: f32| {
        let Some(side) = side else { return };
        mask.weights.iter().for_each(|(i, w)| parts[*i as usize][side] += sign * w);
    };
    pieces.iter().zip(&sides).for_each(|(piece, &side)| add(&mut parts, mask(piece), side, 1.0));
    let mut larger = vec![0; pieces.len()];
    for _ in 0..PASSES {
        for ((piece, side), larger) in pieces.iter().zip(&mut sides).zip(&mut larger) {
            if let Some(i) = seed.iter().position(|s| s == piece) {
                *larger = i;
                continue;
            }
            add(&mut parts, mask(piece), *side, -1.0);
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
            add(&mut parts, mask(piece), *side, 1.0);
        }
    }
    (parts, larger)
}

/// How much the views say that two parts are one thing, and that they are two; see [`super::merge::pairs`].
fn says(groups: &Groups, views: &[Masks], parts: &Parts) -> (f64, f64) {
    let share = |weights: &[(u32, f32)]| {
        let mut shown = [0.0_f64; 2];
        for &(gaussian, weight) in weights {
            let [a, b] = parts[gaussian as usize];
            let side = usize::from(b > a);
            let own = f64::from(parts[gaussian as usize][side]);
            if own > 0.0 {
                let all: f64 = groups.owners()[gaussian as usize].iter().map(|(_, w)| f64::from(*w)).sum();
                shown[side] += f64::from(weight) * (own / all.max(own));
            }
        }
        shown
    };
    let places: Vec<[Places; 2]> = views
        .iter()
        .map(|view| {
            let shown: Vec<[f64; 2]> = view.segments.iter().map(|mask| share(&mask.weights)).collect();
            let rest = share(&view.rest);
            [0, 1].map(|side| covering(shown.iter().map(|shown| shown[side]), rest[side]))
        })
        .collect();
    let most = [0, 1].map(|side| places.iter().map(|places| places[side].total).fold(0.0, f64::max));
    let (mut one, mut two) = (0.0, 0.0);
    for [a, b] in places {
        let (Some(at_a), Some(at_b)) = (a.mask, b.mask) else { continue };
        *(if at_a == at_b { &mut one } else { &mut two }) += say((a.total / most[0]).min(b.total / most[1]));
    }
    (one, two)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::groups::Kind;
    use std::borrow::Cow;

    const KIND: Kind = Kind { class: None, thing: true };

    /// First Gaussian of a segment and one past its last.
    type Span = (u32, u32);

    /// Views of 20 Gaussians, each with ten pixels on every Gaussian of its segments.
    fn views(of: &[&[Span]]) -> Vec<Masks> {
        let mask = |(id, &(first, end)): (usize, &Span)| Mask {
            segment: Segment { id: id as u16 + 1, class: None, thing: true },
            weights: (first..end).map(|g| (g, 10.0)).collect(),
            total: 10.0 * f64::from(end - first),
        };
        of.iter()
            .map(|view| Masks { segments: view.iter().enumerate().map(mask).collect(), rest: Vec::new() })
            .collect()
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
        let any = split(&mut groups, views, &mut placed, &order, 0.5);
        (any, placed.iter().map(|view| view.groups.iter().map(|g| g.expect("placed")).collect()).collect())
    }

    #[test]
    fn two_things_that_one_view_joins_are_parted() {
        let apart: &[Span] = &[(0, 12), (12, 20)];
        let (any, groups) = parted(&views(&[&[(0, 20)], apart, apart, apart, &[(0, 12)], &[(12, 20)]]));
        assert!(any);
        // The larger part keeps its number, and the segment of both stays there.
        assert_eq!(groups, [vec![0], vec![0, 1], vec![0, 1], vec![0, 1], vec![0], vec![1]]);
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
            .map(|view| Placed { masks: view.segments.iter().map(Cow::Borrowed).collect(), groups: vec![Some(one); 2] })
            .collect();
        placed.iter().for_each(|view| groups.add(view));
        let heavy = Mask { weights: vec![(0, 1e3), (1, 1e3)], total: 2e3, ..views[0].segments[1].clone() };
        groups.add(&Placed { masks: vec![Cow::Owned(heavy)], groups: vec![Some(other)] });
        assert!(!split(&mut groups, &views, &mut placed, &[0, 1, 2], 0.5));
    }
}
