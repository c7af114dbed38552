//! Groups of segments as weights on the Gaussians that they cover, and how much a view's segments overlap with them.

use super::segments::SegmentWeights;
use super::sums::SparseSums;
use crate::metrics::assignment;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Pixels without a group that are assumed for each Gaussian: one that is seen in one pixel is half known.
const PRIOR_WEIGHT: f64 = 1.0;
/// Weight in the union of a pixel whose Gaussians no view has shown yet.
const UNSEEN_WEIGHT: f64 = 0.1;
/// Weights below this are rounding left over after a segment is removed.
const MIN_WEIGHT: f32 = 1e-3;
/// A segment and a group may belong together from this IoU on, in what the view shows of them.
const MIN_IOU: f64 = 0.25;
/// An unmatched segment is part of the group that claims more than this share of it.
const MIN_CONTAINED: f64 = 0.5;
/// Matching sums IoU in whole steps of one over this.
const IOU_STEPS: f64 = (1_u64 << 48) as f64;

/// Only segments of one category may belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Category {
    pub class: Option<u16>,
    pub thing: bool,
}

impl From<&SegmentWeights> for Category {
    fn from(weights: &SegmentWeights) -> Self {
        Self {
            class: weights.segment.class,
            thing: weights.segment.thing,
        }
    }
}

/// A segment, or a piece of one that was divided.
pub(super) type Piece<'a> = Cow<'a, SegmentWeights>;

/// The segments of a view, some in pieces, and the group of each.
#[derive(Clone, Default)]
pub(super) struct Assigned<'a> {
    /// In the order of the segments. Pieces of a segment have its id.
    pub pieces: Vec<Piece<'a>>,
    /// The group of each piece, where it has one.
    pub groups: Vec<Option<u32>>,
}

impl<'a> Assigned<'a> {
    /// For each segment its pieces, and their groups.
    pub fn by_segment(&self) -> impl Iterator<Item = (&[Piece<'a>], &[Option<u32>])> {
        let segments = self.pieces.chunk_by(|a, b| a.segment.id == b.segment.id);
        let mut rest = &self.groups[..];
        segments.map(move |pieces| {
            let (groups, others) = rest.split_at(pieces.len());
            rest = others;
            (pieces, groups)
        })
    }

    /// The pieces that have a group, with it.
    fn grouped(&self) -> impl Iterator<Item = (&SegmentWeights, u32)> {
        let pieces = self.pieces.iter().zip(&self.groups);
        pieces.filter_map(|(piece, group)| Some((&**piece, (*group)?)))
    }
}

/// What happens to a segment that is matched with no group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unmatched {
    /// It creates a group.
    Creates,
    /// It joins the group that contains it, and creates one if there is none.
    JoinsOrCreates,
    /// It joins the group that contains it, and has no group if there is none.
    Joins,
}

/// Groups of segments as weights on Gaussians: `W_gi`, pixels.
pub(super) struct Groups {
    /// For each Gaussian its groups with their weights.
    owners: Vec<Vec<(u32, f32)>>,
    categories: Vec<Category>,
}

/// How much the segments of a view overlap with the groups.
pub(super) struct Overlaps {
    /// For each segment the groups and the pixels that they claim of it, ascending by group.
    pub claimed: Vec<Vec<(u32, f64)>>,
    /// For each segment, pixels on Gaussians that are known.
    known: Vec<f64>,
    /// What each group claims of all segments of the view.
    visible: BTreeMap<u32, f64>,
}

impl Overlaps {
    /// IoU of a segment with the group as the view shows it, over what is known. Unknown pixels count a little, so that a
    /// sliver of a new object is not a match.
    fn iou(&self, segment: usize, total: f64, group: u32, claimed: f64) -> f64 {
        let known = self.known[segment];
        let visible = self.visible.get(&group).copied().unwrap_or(0.0);
        let union = known + visible - claimed + UNSEEN_WEIGHT * (total - known).max(0.0);
        if union > 0.0 { claimed / union } else { 0.0 }
    }
}

impl Groups {
    /// No groups yet, on `gaussians` Gaussians.
    pub fn new(gaussians: usize) -> Self {
        Self {
            owners: vec![Vec::new(); gaussians],
            categories: Vec::new(),
        }
    }

    /// Number of groups ever created.
    pub fn len(&self) -> usize {
        self.categories.len()
    }

    pub fn category(&self, group: u32) -> Category {
        self.categories[group as usize]
    }

    /// Creates an empty group.
    pub fn create(&mut self, category: Category) -> u32 {
        self.categories.push(category);
        self.len() as u32 - 1
    }

    /// The groups of each Gaussian with their weights.
    pub fn owners(&self) -> &[Vec<(u32, f32)>] {
        &self.owners
    }

    /// The weight of all groups on a Gaussian.
    pub fn total(&self, gaussian: u32) -> f64 {
        let owners = self.owners[gaussian as usize].iter();
        owners.map(|(_, weight)| f64::from(*weight)).sum()
    }

    /// Sums the weights of all groups afresh, so that rounding does not depend on the order of earlier changes.
    pub fn rebuild(&mut self, views: &[Assigned<'_>]) {
        self.owners.iter_mut().for_each(Vec::clear);
        views.iter().for_each(|view| self.add(view));
    }

    /// Adds the segments of a view to their groups.
    pub fn add(&mut self, view: &Assigned<'_>) {
        for (piece, group) in view.grouped() {
            for &(gaussian, weight) in &piece.weights {
                let owners = &mut self.owners[gaussian as usize];
                match owners.iter_mut().find(|(g, _)| *g == group) {
                    Some((_, sum)) => *sum += weight,
                    None => owners.push((group, weight)),
                }
            }
        }
    }

    /// Removes the segments of a view from their groups.
    pub fn remove(&mut self, view: &Assigned<'_>) {
        for (piece, group) in view.grouped() {
            for &(gaussian, weight) in &piece.weights {
                let owners = &mut self.owners[gaussian as usize];
                if let Some(i) = owners.iter().position(|(g, _)| *g == group) {
                    owners[i].1 -= weight;
                    if owners[i].1 < MIN_WEIGHT {
                        owners.remove(i);
                    }
                }
            }
        }
    }

    /// Overlaps of a view's segments with all groups: group g claims of segment m `sum_i w_mi W_gi / (W_i + 1)`, where
    /// `W_gi` is the group's weight on Gaussian i and `W_i` that of all groups.
    pub fn overlaps(&self, pieces: &[Piece<'_>]) -> Overlaps {
        let mut sums = SparseSums::new(self.len());
        let mut overlaps = Overlaps {
            claimed: Vec::with_capacity(pieces.len()),
            known: Vec::with_capacity(pieces.len()),
            visible: BTreeMap::new(),
        };
        for piece in pieces {
            let mut known = 0.0;
            for &(gaussian, weight) in &piece.weights {
                let all = self.total(gaussian);
                let share = f64::from(weight) / (all + PRIOR_WEIGHT);
                known += share * all;
                for &(group, weight) in &self.owners[gaussian as usize] {
                    sums.add(group, share * f64::from(weight));
                }
            }
            let claimed = sums.take();
            for (group, pixels) in &claimed {
                *overlaps.visible.entry(*group).or_insert(0.0) += pixels;
            }
            overlaps.claimed.push(claimed);
            overlaps.known.push(known);
        }
        overlaps
    }

    /// Assigns a group to each segment of a view: one to one at the largest sum of IoU, without pairs below [`MIN_IOU`].
    /// `unmatched` says what happens to the others. All segments of a class of stuff belong to one group.
    pub fn assign<'a>(&mut self, pieces: Vec<Piece<'a>>, unmatched: Unmatched) -> Assigned<'a> {
        let overlaps = self.overlaps(&pieces);
        let mut groups = self.matched(&pieces, &overlaps);
        for (n, piece) in pieces.iter().enumerate() {
            if piece.weights.is_empty() {
                continue;
            }
            let category = Category::from(&**piece);
            if !category.thing {
                let group = self.categories.iter().position(|c| *c == category);
                groups[n] = group.map(|group| group as u32);
            } else if groups[n].is_none() && unmatched != Unmatched::Creates {
                groups[n] = self.container(piece, &overlaps.claimed[n]);
            }
            if groups[n].is_none() && unmatched != Unmatched::Joins {
                groups[n] = Some(self.create(category));
            }
        }
        Assigned { pieces, groups }
    }

    /// The groups of the things among `pieces`, one to one at the largest sum of IoU.
    fn matched(&self, pieces: &[Piece<'_>], overlaps: &Overlaps) -> Vec<Option<u32>> {
        let things: Vec<usize> = (0..pieces.len())
            .filter(|&n| pieces[n].segment.thing)
            .collect();
        let claimants = things.iter().flat_map(|&n| &overlaps.claimed[n]);
        let mut columns: Vec<u32> = claimants.map(|(group, _)| *group).collect();
        columns.sort_unstable();
        columns.dedup();
        let mut values = vec![0; things.len() * columns.len()];
        for (row, &n) in values.chunks_exact_mut(columns.len().max(1)).zip(&things) {
            let category = Category::from(&*pieces[n]);
            for &(group, claimed) in &overlaps.claimed[n] {
                let iou = overlaps.iou(n, pieces[n].total, group, claimed);
                if iou >= MIN_IOU && self.category(group) == category {
                    row[columns.partition_point(|column| *column < group)] =
                        (iou * IOU_STEPS) as i64;
                }
            }
        }
        let mut groups = vec![None; pieces.len()];
        for (&n, column) in things.iter().zip(assignment(&values, columns.len())) {
            groups[n] = column.map(|column| columns[column]);
        }
        groups
    }

    /// The group that claims most of a segment, the first of equals, if that is most of the segment.
    pub fn container(&self, piece: &SegmentWeights, claimed: &[(u32, f64)]) -> Option<u32> {
        let fits = claimed
            .iter()
            .filter(|(group, _)| self.category(*group) == Category::from(piece));
        let most = fits.reduce(|best, other| if other.1 > best.1 { other } else { best });
        most.filter(|(_, pixels)| *pixels > MIN_CONTAINED * piece.total)
            .map(|(group, _)| *group)
    }
}
