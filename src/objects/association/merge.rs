//! Groups that turn out to be one thing, and groups that turn out to be nothing.

use super::groups::Groups;
use super::territory::{Shown, extents};
use crate::error::{Error, Result};
use std::collections::BTreeMap;

/// Share of a group's weight that another must have on the same Gaussians before the two can be one: neighbours share
/// the Gaussians of their border.
const SHARED: f64 = 0.02;
/// Views that say that two groups are two, before any was asked: one view alone does not make one of two.
pub(super) const DOUBT: f64 = 1.0;
/// A view that shows less than this share of a group than another view does counts less than one.
const ENOUGH: f64 = 0.1;
/// A group that has less than this share of its Gaussians is a stray: others have the rest.
const PURITY: f64 = 0.15;

/// How much a view counts that shows the share `part` of what the view does that shows most.
pub(super) fn say(part: f64) -> f64 {
    (part / ENOUGH).min(1.0)
}

/// Weight of each group, pixels, and its purity, the mean of its share `W_gi / W_i` of the Gaussians that it covers.
pub(super) fn totals(groups: &Groups) -> Vec<(f64, f64)> {
    let mut sums = vec![(0.0, 0.0); groups.len()];
    for owners in groups.owners() {
        let all: f64 = owners.iter().map(|(_, w)| f64::from(*w)).sum();
        for &(group, weight) in owners {
            let (weight, sum) = (f64::from(weight), &mut sums[group as usize]);
            sum.0 += weight;
            sum.1 += weight * weight / all;
        }
    }
    sums.into_iter()
        .map(|(total, pure)| (total, if total > 0.0 { pure / total } else { 0.0 }))
        .collect()
}

/// Pairs (smaller, larger) of groups to be made one, each group in one pair at most. `shown` has what each view shows.
///
/// Two groups are one where they share Gaussians and more than the share `above` of the views say so. A view has a say
/// where a segment covers the one group and a segment the other; it says one where that is the same segment. A view that
/// shows little of either, of what the view does that shows most, counts less than one. So a segmenter that sees a part
/// in few views does not keep it apart, and one that takes two things for one in few views, however large they are
/// there, does not join them.
pub(super) fn pairs(groups: &Groups, shown: &[Shown], above: f64) -> Vec<(u32, u32)> {
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for owners in groups.owners() {
        for (i, &(g, a)) in owners.iter().enumerate() {
            for &(h, b) in &owners[..i] {
                *shared.entry((g.min(h), g.max(h))).or_default() += f64::from(a.min(b));
            }
        }
    }
    let totals = totals(groups);
    let extents = extents(groups.len(), shown);
    let places: Vec<BTreeMap<u32, usize>> = shown.iter().map(|shown| shown.places()).collect();
    let mut candidates = Vec::new();
    for ((a, b), pixels) in shared {
        let [wa, wb] = [a, b].map(|g| totals[g as usize].0);
        let kind = groups.kind(a);
        if !kind.thing || kind != groups.kind(b) || pixels <= SHARED * wa.min(wb) {
            continue;
        }
        let (mut one, mut two) = (0.0, DOUBT);
        for (shown, places) in shown.iter().zip(&places) {
            let (Some(at_a), Some(at_b)) = (places.get(&a), places.get(&b)) else {
                continue;
            };
            let part = |g: u32| shown.of(g) / extents[g as usize];
            *(if at_a == at_b { &mut one } else { &mut two }) += say(part(a).min(part(b)));
        }
        if one > above * (one + two) {
            let (large, small) = if wa >= wb { (a, b) } else { (b, a) };
            candidates.push((one / (one + two), small, large));
        }
    }
    candidates.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut touched = vec![false; groups.len()];
    candidates.retain(|&(_, small, large)| {
        let free = !touched[small as usize] && !touched[large as usize];
        touched[small as usize] |= free;
        touched[large as usize] |= free;
        free
    });
    candidates
        .into_iter()
        .map(|(_, small, large)| (small, large))
        .collect()
}

/// Which groups are dropped: those of no more than the share `least` of all weight, and strays.
///
/// # Errors
/// [`Error::Config`] when that leaves none.
pub(super) fn negligible(groups: &Groups, least: f64) -> Result<Vec<bool>> {
    let totals = totals(groups);
    let all: f64 = totals.iter().map(|(total, _)| total).sum();
    let negligible: Vec<bool> = totals
        .iter()
        .map(|(total, purity)| *total <= least * all || *purity < PURITY)
        .collect();
    if negligible.iter().all(|negligible| *negligible) {
        Err(nothing_left(&totals, least))
    } else {
        Ok(negligible)
    }
}

/// Why groups of these weights and purities are all dropped.
fn nothing_left(totals: &[(f64, f64)], least: f64) -> Error {
    const NONE: &str = "data.association = \"none\" trains on the ids of the maps as they are";
    let all: f64 = totals.iter().map(|(total, _)| total).sum();
    if all == 0.0 {
        let found = "gaussians, but no segment of a training view covers any of them";
        let help = format!("check that Gaussians and cameras are of one scene; {NONE}");
        return Error::config(
            "data.association",
            found,
            "Gaussians where the segments are",
            help,
        );
    }
    let largest = totals
        .iter()
        .filter(|(_, purity)| *purity >= PURITY)
        .map(|(total, _)| total / all);
    match largest.reduce(f64::max) {
        Some(largest) => {
            let dropped = totals.iter().filter(|(total, _)| *total > 0.0).count();
            let found = format!("{least}, which drops all {dropped} groups of segments");
            let expected = format!("less than {largest:.2e}, the share of the largest one");
            Error::config(
                "association.min_weight",
                found,
                expected,
                "set a smaller share",
            )
        }
        None => {
            let found = "gaussians, but each group of segments is on Gaussians of which others have the most";
            let expected = "segments of which several views show the same";
            let help = format!(
                "check that raw labels and photos belong together, or raise association.sweeps; {NONE}"
            );
            Error::config("data.association", found, expected, help)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_leaves_no_group_is_named() {
        let said = |totals: &[(f64, f64)], least| nothing_left(totals, least).to_string();
        let message = said(&[(3.0, 0.9), (0.0, 0.0), (1.0, 1.0), (4.0, 0.1)], 0.6);
        for part in [
            "association.min_weight: found 0.6",
            "all 3 groups",
            "less than 3.75e-1",
            "smaller share",
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
            message.contains("data.association") && message.contains("others have the most"),
            "{message}"
        );
    }
}
