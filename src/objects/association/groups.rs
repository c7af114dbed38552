//! Groups of segments, as weights on the Gaussians that they cover, and how much a view's segments overlap with them.

use super::masks::Mask;
use crate::ops::assignment;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Pixels of evidence that count as much as none at all: a Gaussian that was seen in one pixel is half known.
const DOUBT: f64 = 1.0;
/// What a pixel of a segment on Gaussians that no view has shown yet counts in the union.
const UNKNOWN: f64 = 0.1;
/// Weights that are left by rounding when a segment is taken out.
const RESIDUE: f32 = 1e-3;
/// A segment that no group takes one to one belongs to the group that claims more than this share of it: a part of it.
const CONTAINED: f64 = 0.5;

/// Which segments may belong together: those of one class, things with things.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Kind {
    pub class: Option<u16>,
    pub thing: bool,
}

impl From<&Mask> for Kind {
    fn from(mask: &Mask) -> Self {
        Self {
            class: mask.segment.class,
            thing: mask.segment.thing,
        }
    }
}

/// The segments of a view, some in pieces, and the group of each.
#[derive(Clone, Default)]
pub(super) struct Placed<'a> {
    /// In the order of the segments; pieces of one have its id.
    pub masks: Vec<Cow<'a, Mask>>,
    /// The group of each, where it has one.
    pub groups: Vec<Option<u32>>,
}

impl Placed<'_> {
    /// For each segment, the groups of its pieces.
    pub fn by_segment(&self) -> impl Iterator<Item = &[Option<u32>]> {
        let mut from = 0;
        self.masks
            .chunk_by(|a, b| a.segment.id == b.segment.id)
            .map(move |pieces| {
                from += pieces.len();
                &self.groups[from - pieces.len()..from]
            })
    }
}

/// What happens to segments that no group takes one to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Leftovers {
    /// They may join the group that contains them.
    pub join: bool,
    /// They open a group, else they belong to none.
    pub open: bool,
}

/// All groups.
#[derive(Clone, Debug)]
pub(super) struct Groups {
    /// The groups of each Gaussian with their weights, pixels.
    owners: Vec<Vec<(u32, f32)>>,
    kinds: Vec<Kind>,
}

/// How a view's segments and the groups overlap, in pixels.
pub(super) struct Overlaps {
    /// For each segment, what each group claims of it; ascending by group.
    pub claimed: Vec<Vec<(u32, f64)>>,
    /// For each segment, pixels on Gaussians that are known.
    known: Vec<f64>,
    /// What each group claims of all segments of the view.
    pub visible: BTreeMap<u32, f64>,
}

impl Overlaps {
    /// IoU of a segment with the group as the view shows it, over what is known. What is not known counts a little, so
    /// that a sliver of a new thing is no match.
    fn iou(&self, mask: usize, total: f64, group: u32, claimed: f64) -> f64 {
        let known = self.known[mask];
        let visible = self.visible.get(&group).copied().unwrap_or(0.0);
        let union = known + visible - claimed + UNKNOWN * (total - known).max(0.0);
        if union > 0.0 { claimed / union } else { 0.0 }
    }
}

impl Groups {
    /// None yet, on `gaussians` Gaussians.
    pub fn new(gaussians: usize) -> Self {
        Self {
            owners: vec![Vec::new(); gaussians],
            kinds: Vec::new(),
        }
    }

    /// Number of groups ever opened.
    pub fn len(&self) -> usize {
        self.kinds.len()
    }

    pub fn kind(&self, group: u32) -> Kind {
        self.kinds[group as usize]
    }

    /// Opens an empty group.
    pub fn open(&mut self, kind: Kind) -> u32 {
        self.kinds.push(kind);
        self.len() as u32 - 1
    }

    /// The groups of each Gaussian with their weights.
    pub fn owners(&self) -> &[Vec<(u32, f32)>] {
        &self.owners
    }

    /// The weight of all groups on a Gaussian.
    pub fn total(&self, gaussian: u32) -> f64 {
        self.owners[gaussian as usize]
            .iter()
            .map(|(_, w)| f64::from(*w))
            .sum()
    }

    /// Takes the groups away from all Gaussians, but keeps their numbers.
    pub fn clear(&mut self) {
        self.owners.iter_mut().for_each(Vec::clear);
    }

    /// Adds the segments of a view to their groups.
    pub fn add(&mut self, view: &Placed<'_>) {
        for (mask, group) in view.masks.iter().zip(&view.groups) {
            let Some(group) = *group else { continue };
            for &(gaussian, weight) in &mask.weights {
                let owners = &mut self.owners[gaussian as usize];
                match owners.iter_mut().find(|(g, _)| *g == group) {
                    Some((_, sum)) => *sum += weight,
                    None => owners.push((group, weight)),
                }
            }
        }
    }

    /// Takes the segments of a view out of their groups.
    pub fn remove(&mut self, view: &Placed<'_>) {
        for (mask, group) in view.masks.iter().zip(&view.groups) {
            let Some(group) = *group else { continue };
            for &(gaussian, weight) in &mask.weights {
                let owners = &mut self.owners[gaussian as usize];
                if let Some(i) = owners.iter().position(|(g, _)| *g == group) {
                    owners[i].1 -= weight;
                    if owners[i].1 < RESIDUE {
                        owners.remove(i);
                    }
                }
            }
        }
    }

    /// Overlaps of a view's segments with all groups: group g claims of segment m `sum_i w_mi W_gi / (W_i + 1)`, where
    /// `W_gi` is the group's weight on Gaussian i and `W_i` that of all groups.
    pub fn overlaps(&self, masks: &[Cow<'_, Mask>]) -> Overlaps {
        let mut sums = vec![0.0_f64; self.len()];
        let mut visible = BTreeMap::new();
        let (mut claimed, mut known) = (
            Vec::with_capacity(masks.len()),
            Vec::with_capacity(masks.len()),
        );
        for mask in masks {
            let (mut seen, mut touched) = (0.0, Vec::new());
            for &(gaussian, weight) in &mask.weights {
                let owners = &self.owners[gaussian as usize];
                let all: f64 = owners.iter().map(|(_, w)| f64::from(*w)).sum();
                let share = f64::from(weight) / (all + DOUBT);
                seen += share * all;
                for &(group, w) in owners {
                    let sum = &mut sums[group as usize];
                    if *sum == 0.0 {
                        touched.push(group);
                    }
                    *sum += share * f64::from(w);
                }
            }
            touched.sort_unstable();
            let row: Vec<_> = touched
                .into_iter()
                .map(|g| (g, std::mem::take(&mut sums[g as usize])))
                .collect();
            row.iter()
                .for_each(|(group, pixels)| *visible.entry(*group).or_insert(0.0) += pixels);
            claimed.push(row);
            known.push(seen);
        }
        Overlaps {
            claimed,
            known,
            visible,
        }
    }

    /// The group of each segment of a view: one to one at the largest sum of IoU, pairs below `least` left out; what
    /// stays alone as `leftovers` says. All segments of a class of stuff belong to one group.
    pub fn place<'a>(
        &mut self,
        masks: Vec<Cow<'a, Mask>>,
        least: f64,
        leftovers: Leftovers,
    ) -> Placed<'a> {
        let overlaps = self.overlaps(&masks);
        let mut assigned = vec![None; masks.len()];
        let things: Vec<usize> = (0..masks.len())
            .filter(|&m| masks[m].segment.thing)
            .collect();
        let mut columns: Vec<u32> = things
            .iter()
            .flat_map(|&m| overlaps.claimed[m].iter().map(|(g, _)| *g))
            .collect();
        columns.sort_unstable();
        columns.dedup();
        let mut values = vec![0.0; things.len() * columns.len()];
        for (row, &m) in values.chunks_exact_mut(columns.len().max(1)).zip(&things) {
            for &(group, claimed) in &overlaps.claimed[m] {
                let iou = overlaps.iou(m, masks[m].total, group, claimed);
                if let (Ok(column), true) = (
                    columns.binary_search(&group),
                    self.kind(group) == Kind::from(&*masks[m]),
                ) {
                    row[column] = if iou >= least { iou } else { 0.0 };
                }
            }
        }
        for (&m, column) in things.iter().zip(assignment(&values, columns.len())) {
            assigned[m] = column.map(|column| columns[column]);
        }
        for (m, mask) in masks
            .iter()
            .enumerate()
            .filter(|(_, mask)| !mask.weights.is_empty())
        {
            let kind = Kind::from(&**mask);
            if !kind.thing {
                assigned[m] = self
                    .kinds
                    .iter()
                    .position(|k| *k == kind)
                    .map(|group| group as u32);
            } else if assigned[m].is_none() && leftovers.join {
                assigned[m] = self.container(mask, &overlaps.claimed[m]);
            }
            if assigned[m].is_none() && leftovers.open {
                assigned[m] = Some(self.open(kind));
            }
        }
        Placed {
            masks,
            groups: assigned,
        }
    }

    /// The group that claims most of a segment.
    pub fn container(&self, mask: &Mask, claimed: &[(u32, f64)]) -> Option<u32> {
        let fits = claimed
            .iter()
            .filter(|(group, _)| self.kind(*group) == Kind::from(mask));
        // Of equal claims the first.
        let most = fits.fold(
            None,
            |best: Option<(u32, f64)>, &(group, pixels)| match best {
                Some((_, most)) if most >= pixels => best,
                _ => Some((group, pixels)),
            },
        );
        most.filter(|(_, pixels)| *pixels > CONTAINED * mask.total)
            .map(|(group, _)| group)
    }
}
