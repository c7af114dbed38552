//! Groups that turn out to be one thing, and groups that turn out to be nothing.

use super::groups::{Assigned, Groups, Overlaps};
use super::masks::Mask;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Share of a group's weight that another must have on the same Gaussians before the two can be one: neighbours share
/// the Gaussians of their border.
const SHARED: f64 = 0.15;
/// A group that has less than this share of its Gaussians is a stray: others have the rest.
const PURITY: f64 = 0.15;

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
    sums.into_iter().map(|(total, pure)| (total, if total > 0.0 { pure / total } else { 0.0 })).collect()
}

/// Pairs (smaller, larger) of groups to be made one, each group in one pair at most.
///
/// Two groups are one where they share Gaussians and the views of the larger one, wherever they show the smaller one,
/// mostly call it the larger one. Parts that a segmenter sees in few views go into the whole; things that it takes for
/// one in few views stay two.
pub(super) fn pairs(groups: &Groups, views: &[Vec<Mask>], assigned: &[Assigned], above: f64) -> Vec<(u32, u32)> {
    // For (g, h): pixels of h in the views of g, and those of them in the segments of g.
    let mut shown: BTreeMap<(u32, u32), [f64; 2]> = BTreeMap::new();
    let overlaps: Vec<Overlaps> = views.par_iter().map(|masks| groups.overlaps(masks)).collect();
    for (overlaps, assigned) in overlaps.iter().zip(assigned) {
        let mut present: Vec<u32> = assigned.iter().flatten().copied().collect();
        present.sort_unstable();
        present.dedup();
        for &g in &present {
            overlaps.visible.iter().for_each(|(&h, pixels)| shown.entry((g, h)).or_default()[0] += pixels);
        }
        for (claimed, g) in overlaps.claimed.iter().zip(assigned) {
            let Some(g) = *g else { continue };
            claimed.iter().for_each(|&(h, pixels)| shown.entry((g, h)).or_default()[1] += pixels);
        }
    }
    let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    for owners in groups.owners() {
        for (i, &(g, a)) in owners.iter().enumerate() {
            for &(h, b) in &owners[..i] {
                *shared.entry((g.min(h), g.max(h))).or_default() += f64::from(a.min(b));
            }
        }
    }
    let totals = totals(groups);
    let mut candidates = Vec::new();
    for ((a, b), pixels) in shared {
        let [wa, wb] = [a, b].map(|g| totals[g as usize].0);
        let (large, small) = if wa >= wb { (a, b) } else { (b, a) };
        let kind = groups.kind(large);
        let [seen, taken] = shown.get(&(large, small)).copied().unwrap_or_default();
        let one = kind.thing && kind == groups.kind(small) && pixels > SHARED * wa.min(wb) && taken > above * seen;
        if one {
            candidates.push((taken / seen, small, large));
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
    candidates.into_iter().map(|(_, small, large)| (small, large)).collect()
}

/// Which groups are dropped: those of less than `least` of all weight, and strays.
pub(super) fn negligible(groups: &Groups, least: f64) -> Vec<bool> {
    let totals = totals(groups);
    let all: f64 = totals.iter().map(|(total, _)| total).sum();
    totals.iter().map(|(total, purity)| *total <= least * all || *purity < PURITY).collect()
}
