//! Segments that cover several groups: a segmenter took two objects for one.

use super::groups::{Category, Groups};
use super::ownership::group_sightings;
use super::segments::{SegmentWeights, ViewSegments};
use crate::data::first_largest;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// A view does not count for a group when it shows less than this share of what the best view shows: a sliver may be the rim
/// of Gaussians that stand in front.
const MIN_VISIBLE: f64 = 0.1;

/// The segments of a view, in order. A segment that covers several groups of its category is divided among them: each Gaussian
/// goes to the group with the most weight on it. `extents` are those of [`super::ownership::extents`].
pub(super) fn divided<'a>(
    groups: &Groups,
    view: &'a ViewSegments,
    extents: &[f64],
) -> Vec<Cow<'a, SegmentWeights>> {
    // Groups with their pixels, ascending by group.
    let mut covered: BTreeMap<usize, Vec<(u32, f64)>> = BTreeMap::new();
    for seen in group_sightings(groups, view) {
        let Some((segment, pixels)) = seen.covered_by else {
            continue;
        };
        let category = Category::from(&view.segments[segment]);
        if groups.category(seen.group) == category
            && seen.total > MIN_VISIBLE * extents[seen.group as usize]
        {
            let covered = covered.entry(segment).or_default();
            covered.push((seen.group, pixels));
        }
    }
    let mut pieces = Vec::with_capacity(view.segments.len());
    for (n, segment) in view.segments.iter().enumerate() {
        match covered.get(&n) {
            Some(covered) if covered.len() > 1 => {
                pieces.extend(cut(groups, segment, covered).into_iter().map(Cow::Owned));
            }
            _ => pieces.push(Cow::Borrowed(segment)),
        }
    }
    pieces
}

/// The pieces of a segment, one for each of the groups that has a Gaussian of it. Gaussians that none of them has go to the
/// group that shows most.
fn cut(groups: &Groups, segment: &SegmentWeights, covered: &[(u32, f64)]) -> Vec<SegmentWeights> {
    let largest = first_largest(covered.iter().map(|(_, pixels)| *pixels)).unwrap_or(0);
    let empty = SegmentWeights {
        segment: segment.segment,
        weights: Vec::new(),
        total: 0.0,
    };
    let mut pieces = vec![empty; covered.len()];
    for &(gaussian, weight) in &segment.weights {
        let mut best = (largest, 0.0);
        for &(group, w) in &groups.owners()[gaussian as usize] {
            if let Ok(i) = covered.binary_search_by_key(&group, |(group, _)| *group)
                && w > best.1
            {
                best = (i, w);
            }
        }
        let piece = &mut pieces[best.0];
        piece.weights.push((gaussian, weight));
        piece.total += f64::from(weight);
    }
    pieces.retain(|piece| !piece.weights.is_empty());
    pieces
}
