//! The merge graph: pairs of groups that are one object, and groups that are negligible.

use super::groups::Groups;
use super::ownership::{Evidence, Sighting, evidence};
use crate::error::{Error, Result, invalid};
use std::collections::BTreeMap;

/// Two groups can be one object when they share more than this part of the lighter one's weight. Neighbours share the Gaussians of
/// their border.
const MIN_SHARED: f64 = 0.02;
/// Views that are assumed to speak against each merge, so that no view decides alone.
const PRIOR_VIEWS: f64 = 1.0;
/// Groups are merged when more than this share of the views that show both put them into one segment. [`PRIOR_VIEWS`] further views
/// are assumed to speak against it.
const MIN_AGREEMENT: f64 = 0.5;
/// A group with a lower purity is a stray: others have most of its Gaussians.
const MIN_PURITY: f64 = 0.15;

/// The size of a group.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Total {
    /// Pixels.
    pub weight: f64,
    /// Mean of its share `W_gi / W_i` of the Gaussians that it covers.
    purity: f64,
}

/// The size of each group.
pub(super) fn totals(groups: &Groups) -> Vec<Total> {
    let mut totals = vec![Total::default(); groups.len()];
    for (gaussian, owners) in (0..).zip(groups.owners()) {
        let all = groups.total(gaussian);
        for &(group, weight) in owners {
            let total = &mut totals[group as usize];
            let weight = f64::from(weight);
            total.weight += weight;
            total.purity += weight * weight / all;
        }
    }
    for total in totals.iter_mut().filter(|total| total.weight > 0.0) {
        total.purity /= total.weight;
    }
    totals
}

/// Pairs (smaller, larger) of groups to merge. Each group is in one pair at most. `sightings` has what each view shows, `extents`
/// the most that a view shows of each group.
///
/// Two groups are merged where they share Gaussians and more than the share [`MIN_AGREEMENT`] of the views say that they are one
/// ([`evidence`]). So a part that the segmenter separates in few views does not stay apart, and two objects that it joins in few
/// views are not merged, however large they are there.
pub(super) fn pairs(
    groups: &Groups,
    sightings: &[Vec<Sighting>],
    extents: &[f64],
) -> Vec<(u32, u32)> {
    let totals = totals(groups);
    let mut candidates = Vec::new();
    for ((a, b), pixels) in shared_weights(groups) {
        let [weight_a, weight_b] = [a, b].map(|group| totals[group as usize].weight);
        let category = groups.category(a);
        let can_merge = category.thing && category == groups.category(b);
        if !can_merge || pixels <= MIN_SHARED * weight_a.min(weight_b) {
            continue;
        }
        let Evidence { one, two } = evidence(sightings, extents, [a, b]);
        let all = one + two + PRIOR_VIEWS;
        if one > MIN_AGREEMENT * all {
            let [small, large] = if weight_a >= weight_b { [b, a] } else { [a, b] };
            candidates.push((one / all, small, large));
        }
    }
    candidates.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut taken = vec![false; groups.len()];
    candidates.retain(|&(_, small, large)| {
        let free = !taken[small as usize] && !taken[large as usize];
        if free {
            taken[small as usize] = true;
            taken[large as usize] = true;
        }
        free
    });
    let pair = |(_, small, large)| (small, large);
    candidates.into_iter().map(pair).collect()
}

/// For each pair of groups on a Gaussian the sum of the smaller weight of the two.
fn shared_weights(groups: &Groups) -> BTreeMap<(u32, u32), f64> {
    let mut shared = BTreeMap::new();
    for owners in groups.owners() {
        for (i, &(g, a)) in owners.iter().enumerate() {
            for &(h, b) in &owners[..i] {
                *shared.entry((g.min(h), g.max(h))).or_default() += f64::from(a.min(b));
            }
        }
    }
    shared
}

/// Which groups are negligible: those of no more than the share `least` of all weight, and strays.
///
/// # Errors
/// [`Error::Config`] when all are.
pub(super) fn negligible(groups: &Groups, least: f64) -> Result<Vec<bool>> {
    let totals = totals(groups);
    let all: f64 = totals.iter().map(|total| total.weight).sum();
    let small = |total: &Total| total.weight <= least * all || total.purity < MIN_PURITY;
    let negligible: Vec<bool> = totals.iter().map(small).collect();
    if negligible.iter().all(|negligible| *negligible) {
        return Err(nothing_left(&totals, least));
    }
    Ok(negligible)
}

/// Why all groups of these sizes are negligible.
fn nothing_left(totals: &[Total], least: f64) -> Error {
    const NONE: &str = "data.association = \"none\" trains on the ids of the maps as they are";
    let all: f64 = totals.iter().map(|total| total.weight).sum();
    if all == 0.0 {
        return invalid!(setting "data.association";
            found "gaussians, but no segment of a training view covers any of them";
            expected "Gaussians where the segments are";
            help "check that Gaussians and cameras are of one scene; {NONE}");
    }
    let pure = totals.iter().filter(|total| total.purity >= MIN_PURITY);
    let Some(largest) = pure.map(|total| total.weight / all).reduce(f64::max) else {
        return invalid!(setting "data.association";
            found "gaussians, but others have most of the Gaussians of every group of segments";
            expected "segments of which several views show the same";
            help "check that raw labels and photos belong together; {NONE}");
    };
    let dropped = totals.iter().filter(|total| total.weight > 0.0).count();
    invalid!(setting "data.association";
        found "gaussians, but all {dropped} groups of segments are small: the largest has {largest:.2e} of the weight";
        expected "a group of at least {least}";
        help "give a segmentation of larger things, or more views of them; {NONE}")
}

#[cfg(test)]
mod tests {
    use super::super::groups::{Assigned, Category};
    use super::super::segments::SegmentWeights;
    use super::*;
    use crate::data::Segment;
    use std::borrow::Cow;

    #[test]
    fn small_groups_and_strays_are_negligible() {
        let segment = Segment {
            id: 1,
            class: None,
            thing: true,
        };
        let mut groups = Groups::new(4);
        // The last group covers one Gaussian, most of which belongs to another group.
        for weights in [vec![(0, 30.0), (1, 30.0)], vec![(2, 4.0)], vec![(1, 4.0)]] {
            let weights = SegmentWeights {
                segment,
                total: 0.0,
                weights,
            };
            let group = groups.create(Category::from(&weights));
            groups.add(&Assigned {
                pieces: vec![Cow::Owned(weights)],
                groups: vec![Some(group)],
            });
        }
        let found = |least| negligible(&groups, least);
        assert_eq!(found(0.01).expect("two left"), [false, false, true]);
        assert_eq!(found(0.1).expect("one left"), [false, true, true]);
        let error = found(1.0).expect_err("none left").to_string();
        assert!(
            error.contains("all 3 groups") && error.contains("at least 1"),
            "{error}"
        );
    }

    #[test]
    fn what_leaves_no_group_is_named() {
        let said = |totals: &[(f64, f64)], least| {
            let total = |&(weight, purity): &(f64, f64)| Total { weight, purity };
            let totals: Vec<Total> = totals.iter().map(total).collect();
            nothing_left(&totals, least).to_string()
        };
        let message = said(&[(3.0, 0.9), (0.0, 0.0), (1.0, 1.0), (4.0, 0.1)], 0.6);
        for part in [
            "data.association",
            "all 3 groups",
            "the largest has 3.75e-1",
            "at least 0.6",
            "larger things",
        ] {
            assert!(message.contains(part), "{part}: {message}");
        }
        let message = said(&[], 0.0) + &said(&[(0.0, 0.0)], 0.0);
        assert_eq!(
            message.matches("covers any of them").count(),
            2,
            "{message}"
        );
        let message = said(&[(1.0, 0.1), (1.0, 0.1)], 0.0);
        assert!(
            message.contains("data.association") && message.contains("others have most"),
            "{message}"
        );
    }
}
