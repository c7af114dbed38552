//! Which Gaussians belong to which group, and what a view shows of them.
//!
//! The group with the most weight on a Gaussian owns it: a few segments that cover two objects leave less weight on the other
//! object than that object's own group has. An owner counts by its share of all weight there.

use super::groups::Groups;
use super::segments::ViewSegments;
use super::sums::SparseSums;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A segment covers a group when it shows more than this share of what all segments of the view show of the group,
const MIN_OF_LABELLED: f64 = 0.5;
/// and more than this share of what the view shows of the group: where its own segment is missing, neighbours show its rim.
const MIN_OF_VISIBLE: f64 = 0.25;
/// A view counts fully from this share of what the best view shows; below it, in proportion.
const FULL_WEIGHT_EXTENT: f64 = 0.1;

/// What a view shows of the Gaussians of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sighting {
    pub group: u32,
    /// Pixels in the whole view.
    pub total: f64,
    /// The segment that covers the group, if any, and its pixels of the group.
    pub covered_by: Option<(usize, f64)>,
}

/// What a view shows of the Gaussians that each group owns, ascending by group.
pub(super) fn group_sightings(groups: &Groups, view: &ViewSegments) -> Vec<Sighting> {
    let mut sums = SparseSums::new(groups.len());
    let mut row = |weights: &[(u32, f32)]| {
        for &(gaussian, weight) in weights {
            let owners = &groups.owners()[gaussian as usize];
            let most = owners.iter().map(|(_, w)| *w).fold(0.0, f32::max);
            let all = groups.total(gaussian);
            for &(group, w) in owners.iter().filter(|(_, w)| *w >= most) {
                sums.add(group, f64::from(weight) * f64::from(w) / all);
            }
        }
        sums.take()
    };
    let mut in_segments: BTreeMap<u32, Vec<(usize, f64)>> = BTreeMap::new();
    for (number, segment) in view.segments.iter().enumerate() {
        for (group, pixels) in row(&segment.weights) {
            in_segments.entry(group).or_default().push((number, pixels));
        }
    }
    let unlabelled = row(&view.unlabelled);
    for (group, _) in &unlabelled {
        in_segments.entry(*group).or_default();
    }
    let mut unlabelled = unlabelled.into_iter().peekable();
    let sighting = |(group, segments): (u32, Vec<(usize, f64)>)| {
        let labelled: f64 = segments.iter().map(|(_, pixels)| pixels).sum();
        let rest = unlabelled.next_if(|(other, _)| *other == group);
        let total = labelled + rest.map_or(0.0, |(_, pixels)| pixels);
        let covers = |&(_, pixels): &(usize, f64)| {
            pixels > MIN_OF_LABELLED * labelled && pixels > MIN_OF_VISIBLE * total
        };
        Sighting {
            group,
            total,
            covered_by: segments.into_iter().find(covers),
        }
    };
    in_segments.into_iter().map(sighting).collect()
}

/// [`group_sightings`] of each view.
pub(super) fn sightings_in_views(groups: &Groups, views: &[ViewSegments]) -> Vec<Vec<Sighting>> {
    views
        .par_iter()
        .map(|view| group_sightings(groups, view))
        .collect()
}

/// The most that a view shows of each of `groups` groups, pixels.
pub(super) fn extents(groups: usize, views: &[Vec<Sighting>]) -> Vec<f64> {
    let mut extents = vec![0.0_f64; groups];
    for seen in views.iter().flatten() {
        let extent = &mut extents[seen.group as usize];
        *extent = extent.max(seen.total);
    }
    extents
}

/// How many views say that two groups are one object, and how many that they are two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Evidence {
    pub one: f64,
    pub two: f64,
}

/// The evidence of `views` on two groups. A view counts where segments cover both. One segment that covers both is evidence for
/// one object, two segments are evidence for two. A view that shows little of a group, compared with the best view, counts less.
pub(super) fn evidence(views: &[Vec<Sighting>], extents: &[f64], pair: [u32; 2]) -> Evidence {
    let mut evidence = Evidence::default();
    for view in views {
        let found = pair.map(|group| {
            let index = view.binary_search_by_key(&group, |seen| seen.group);
            index.ok().map(|index| view[index])
        });
        let [Some(a), Some(b)] = found else { continue };
        let (Some((in_a, _)), Some((in_b, _))) = (a.covered_by, b.covered_by) else {
            continue;
        };
        let share = |seen: Sighting| seen.total / extents[seen.group as usize];
        let weight = (share(a).min(share(b)) / FULL_WEIGHT_EXTENT).min(1.0);
        if in_a == in_b {
            evidence.one += weight;
        } else {
            evidence.two += weight;
        }
    }
    evidence
}
