//! Which Gaussians belong to which group, and what a view shows of them.
//!
//! The group with the most weight on a Gaussian owns it: a few segments that cover two objects leave less weight on the other
//! object than that object's own group has. An owner counts by its share of all weight there.

use super::groups::Groups;
use super::segments::ViewSegments;
use super::sums::SparseSums;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A segment covers a set when it shows more than this share of what all segments of the view show of the set,
const MIN_OF_LABELLED: f64 = 0.5;
/// and more than this share of what the view shows of the set: where its own segment is missing, neighbours show its rim.
const MIN_OF_VISIBLE: f64 = 0.25;
/// A view counts fully from this share of what the best view shows; below it, in proportion.
const FULL_WEIGHT_EXTENT: f64 = 0.1;

/// What a view shows of some set of Gaussians, such as those of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighting {
    /// Which set.
    pub set: u32,
    /// Pixels in the whole view.
    pub total: f64,
    /// The segment that covers the set, if any, and its pixels of the set.
    pub covered_by: Option<(usize, f64)>,
}

/// What a view shows of sets of Gaussians, ascending by set. `pixels` gives the sets of a Gaussian, and how many of its pixels
/// in the view count for each.
pub(super) fn sightings<I: Iterator<Item = (u32, f64)>>(
    view: &ViewSegments,
    sums: &mut SparseSums,
    pixels: impl Fn(u32, f64) -> I,
) -> Vec<Sighting> {
    let mut row = |weights: &[(u32, f32)]| {
        for &(gaussian, weight) in weights {
            for (set, pixels) in pixels(gaussian, f64::from(weight)) {
                sums.add(set, pixels);
            }
        }
        sums.take()
    };
    let mut in_segments: BTreeMap<u32, Vec<(usize, f64)>> = BTreeMap::new();
    for (number, segment) in view.segments.iter().enumerate() {
        for (set, pixels) in row(&segment.weights) {
            in_segments.entry(set).or_default().push((number, pixels));
        }
    }
    let unlabelled = row(&view.unlabelled);
    for (set, _) in &unlabelled {
        in_segments.entry(*set).or_default();
    }
    let mut unlabelled = unlabelled.into_iter().peekable();
    let sighting = |(set, segments): (u32, Vec<(usize, f64)>)| {
        let labelled: f64 = segments.iter().map(|(_, pixels)| pixels).sum();
        let rest = unlabelled.next_if(|(other, _)| *other == set);
        let total = labelled + rest.map_or(0.0, |(_, pixels)| pixels);
        let covers = |&(_, pixels): &(usize, f64)| {
            pixels > MIN_OF_LABELLED * labelled && pixels > MIN_OF_VISIBLE * total
        };
        Sighting {
            set,
            total,
            covered_by: segments.into_iter().find(covers),
        }
    };
    in_segments.into_iter().map(sighting).collect()
}

/// What a view shows of the Gaussians that each group owns.
pub(super) fn group_sightings(groups: &Groups, view: &ViewSegments) -> Vec<Sighting> {
    let mut sums = SparseSums::new(groups.len());
    sightings(view, &mut sums, |gaussian, weight| {
        let owners = &groups.owners()[gaussian as usize];
        let most = owners.iter().map(|(_, w)| *w).fold(0.0, f32::max);
        let all = groups.total(gaussian);
        owners
            .iter()
            .filter(move |(_, w)| *w >= most)
            .map(move |&(group, w)| (group, weight * f64::from(w) / all))
    })
}

/// [`group_sightings`] of each view.
pub(super) fn sightings_in_views(groups: &Groups, views: &[ViewSegments]) -> Vec<Vec<Sighting>> {
    views
        .par_iter()
        .map(|view| group_sightings(groups, view))
        .collect()
}

/// The most that a view shows of each of `sets` sets, pixels.
pub(super) fn extents(sets: usize, views: &[Vec<Sighting>]) -> Vec<f64> {
    let mut extents = vec![0.0_f64; sets];
    for seen in views.iter().flatten() {
        let extent = &mut extents[seen.set as usize];
        *extent = extent.max(seen.total);
    }
    extents
}

/// How many views say that two sets are one object, and how many that they are two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Evidence {
    pub one: f64,
    pub two: f64,
}

/// The evidence of `views` on two sets. A view counts where segments cover both sets. One segment that covers both is evidence for
/// one object, two segments are evidence for two. A view that shows little of a set, compared with the best view, counts less.
pub(super) fn evidence(views: &[Vec<Sighting>], extents: &[f64], pair: [u32; 2]) -> Evidence {
    let mut evidence = Evidence::default();
    for view in views {
        let found = pair.map(|set| {
            let index = view.binary_search_by_key(&set, |seen| seen.set);
            index.ok().map(|index| view[index])
        });
        let [Some(a), Some(b)] = found else { continue };
        let (Some((in_a, _)), Some((in_b, _))) = (a.covered_by, b.covered_by) else {
            continue;
        };
        let share = |seen: Sighting| seen.total / extents[seen.set as usize];
        let weight = (share(a).min(share(b)) / FULL_WEIGHT_EXTENT).min(1.0);
        if in_a == in_b {
            evidence.one += weight;
        } else {
            evidence.two += weight;
        }
    }
    evidence
}
