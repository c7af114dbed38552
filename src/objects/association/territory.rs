//! Where groups are at home, and what of that a view shows.
//!
//! A group is at home on the Gaussians on which none has more weight: what a few segments that cover two things leave on
//! the other one is less than that one has. There it counts by its share of all weight.

use super::groups::Groups;
use super::masks::Masks;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A segment covers a group when it shows more than this share of what all segments of the view show of the group,
const COVERED: f64 = 0.5;
/// and more than this share of what the view shows of it: where its own segment is missing, neighbours show its rim.
const IN_VIEW: f64 = 0.25;

/// What a view shows of the groups' homes, pixels.
pub(super) struct Shown {
    /// In each segment, ascending by group.
    pub by_mask: Vec<Vec<(u32, f64)>>,
    /// In all segments together.
    labelled: BTreeMap<u32, f64>,
    /// In the whole view, pixels without a segment included.
    total: BTreeMap<u32, f64>,
}

impl Shown {
    pub fn new(groups: &Groups, view: &Masks) -> Self {
        let mut sums = vec![0.0; groups.len()];
        let by_mask: Vec<_> = view
            .segments
            .iter()
            .map(|mask| at_home(groups, &mask.weights, &mut sums))
            .collect();
        let mut labelled = BTreeMap::new();
        for (group, pixels) in by_mask.iter().flatten() {
            *labelled.entry(*group).or_insert(0.0) += pixels;
        }
        let mut total = labelled.clone();
        for (group, pixels) in at_home(groups, &view.rest, &mut sums) {
            *total.entry(group).or_insert(0.0) += pixels;
        }
        Self {
            by_mask,
            labelled,
            total,
        }
    }

    /// Pixels of a group in the whole view.
    pub fn of(&self, group: u32) -> f64 {
        self.total.get(&group).copied().unwrap_or(0.0)
    }

    /// The groups that a segment covers, and what it shows of them; ascending by group.
    pub fn covered(&self, mask: usize) -> impl Iterator<Item = (u32, f64)> {
        let labelled = |group| self.labelled.get(&group).copied().unwrap_or(0.0);
        let covers = move |&(group, pixels): &(u32, f64)| {
            pixels > COVERED * labelled(group) && pixels > IN_VIEW * self.of(group)
        };
        self.by_mask[mask].iter().copied().filter(covers)
    }

    /// The segment that covers each group, where one does; ascending by group.
    pub fn places(&self) -> BTreeMap<u32, usize> {
        (0..self.by_mask.len())
            .flat_map(|mask| self.covered(mask).map(move |(group, _)| (group, mask)))
            .collect()
    }
}

/// Which segment of a view covers something, and how much of it the view shows.
pub(super) struct Places {
    /// The segment, where one does.
    pub mask: Option<usize>,
    /// Pixels in the whole view.
    pub total: f64,
}

/// Of something of which the segments of a view show `shown` pixels each, and the view `rest` without a segment.
pub(super) fn covering(shown: impl Iterator<Item = f64> + Clone, rest: f64) -> Places {
    let labelled: f64 = shown.clone().sum();
    let total = labelled + rest;
    let covers = |pixels: f64| pixels > COVERED * labelled && pixels > IN_VIEW * total;
    Places {
        mask: shown.into_iter().position(covers),
        total,
    }
}

/// Pixels of `weights` on the homes of the groups, ascending by group; `sums` is zero before and after.
fn at_home(groups: &Groups, weights: &[(u32, f32)], sums: &mut [f64]) -> Vec<(u32, f64)> {
    let mut touched = Vec::new();
    for &(gaussian, weight) in weights {
        let owners = &groups.owners()[gaussian as usize];
        let most = owners.iter().map(|(_, w)| *w).fold(0.0, f32::max);
        let all: f64 = owners.iter().map(|(_, w)| f64::from(*w)).sum();
        for &(group, w) in owners.iter().filter(|(_, w)| *w >= most) {
            let sum = &mut sums[group as usize];
            if *sum == 0.0 {
                touched.push(group);
            }
            *sum += f64::from(weight) * f64::from(w) / all;
        }
    }
    touched.sort_unstable();
    touched
        .into_iter()
        .map(|group| (group, std::mem::take(&mut sums[group as usize])))
        .collect()
}

/// The most that one of these views shows of each group's home, pixels.
pub(super) fn sizes(groups: &Groups, views: &[Masks]) -> Vec<f64> {
    let shown: Vec<Shown> = views
        .par_iter()
        .map(|view| Shown::new(groups, view))
        .collect();
    extents(groups.len(), &shown)
}

/// The most that a view shows of each group's home, pixels.
pub(super) fn extents(groups: usize, shown: &[Shown]) -> Vec<f64> {
    let mut extents = vec![0.0_f64; groups];
    for (&group, &pixels) in shown.iter().flat_map(|shown| &shown.total) {
        let extent = &mut extents[group as usize];
        *extent = extent.max(pixels);
    }
    extents
}
