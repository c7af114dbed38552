//! The groups that may be two objects, and the pieces from which their parts grow.

use crate::objects::association::groups::{Assigned, Groups};
use crate::objects::association::segments::SegmentWeights;
use std::collections::BTreeMap;

/// Pairs of segments from which the parts of a group are grown, at most.
pub(super) const SEEDS: usize = 6;

/// A piece of a group: its view, and its index in the view.
pub(super) type Piece = (usize, usize);

/// Two pieces of a view, from which two parts grow.
pub(super) type Seed = [Piece; 2];

/// A group that may be two objects.
pub(super) struct Candidate {
    pub group: u32,
    /// In the order of the views.
    pub pieces: Vec<Piece>,
    pub seeds: Vec<Seed>,
    /// The Gaussians of the group, ascending.
    pub gaussians: Vec<u32>,
    /// The smaller part of the best partition so far: the one whose smaller part is largest.
    pub best: Option<SmallerPart>,
}

/// The pieces that leave a group, and their weight.
pub(super) struct SmallerPart {
    pub weight: f64,
    pub pieces: Vec<Piece>,
}

/// The groups of things that have two segments of some view, ascending.
pub(super) fn candidates(
    groups: &Groups,
    assigned: &[Assigned<'_>],
    order: &[usize],
) -> Vec<Candidate> {
    let mut pieces: BTreeMap<u32, Vec<Piece>> = BTreeMap::new();
    for &view in order {
        for (index, group) in assigned[view].groups.iter().enumerate() {
            if let Some(group) = group.filter(|group| groups.category(*group).thing) {
                pieces.entry(group).or_default().push((view, index));
            }
        }
    }
    let candidate = |(group, pieces): (u32, Vec<Piece>)| {
        let seeds = seeds(assigned, &pieces);
        (!seeds.is_empty()).then(|| Candidate {
            group,
            pieces,
            seeds,
            gaussians: Vec::new(),
            best: None,
        })
    };
    let mut candidates: Vec<Candidate> = pieces.into_iter().filter_map(candidate).collect();
    for (gaussian, owners) in (0..).zip(groups.owners()) {
        for (group, _) in owners {
            if let Ok(i) = candidates.binary_search_by_key(group, |candidate| candidate.group) {
                candidates[i].gaussians.push(gaussian);
            }
        }
    }
    candidates
}

pub(super) fn weights<'a>(
    assigned: &'a [Assigned<'_>],
    (view, index): Piece,
) -> &'a SegmentWeights {
    &assigned[view].pieces[index]
}

/// The pairs of a view's two largest segments in the group, those with the largest second one first.
fn seeds(assigned: &[Assigned<'_>], pieces: &[Piece]) -> Vec<Seed> {
    let total = |piece: Piece| weights(assigned, piece).total;
    let segment = |piece: Piece| weights(assigned, piece).segment.id;
    let mut pairs = Vec::new();
    for of_view in pieces.chunk_by(|a, b| a.0 == b.0) {
        let mut of_view = of_view.to_vec();
        of_view.sort_by(|&a, &b| total(b).total_cmp(&total(a)).then(a.cmp(&b)));
        let first = of_view[0];
        let other = of_view
            .iter()
            .find(|piece| segment(**piece) != segment(first));
        pairs.extend(other.map(|&second| [first, second]));
    }
    pairs.sort_by(|a, b| total(b[1]).total_cmp(&total(a[1])).then(a.cmp(b)));
    pairs.truncate(SEEDS);
    pairs
}
