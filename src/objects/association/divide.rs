//! Segments that cover several groups at once, as a segmenter makes them that takes two things for one.

use super::groups::{Groups, Kind};
use super::masks::{Mask, Masks};
use super::territory::Shown;
use std::borrow::Cow;

/// Of a group that a view shows less of than this share of what another view does, it says nothing: a sliver may be
/// the rim of Gaussians that stand before it.
const SLIVER: f64 = 0.1;

/// The segments of a view, in order; one that covers several groups of its kind is divided among them, each Gaussian
/// going to the group that has most weight on it. `extents` are those of [`super::territory::extents`].
pub(super) fn divided<'a>(groups: &Groups, view: &'a Masks, extents: &[f64]) -> Vec<Cow<'a, Mask>> {
    let shown = Shown::new(groups, view);
    let mut pieces = Vec::with_capacity(view.segments.len());
    for (m, mask) in view.segments.iter().enumerate() {
        let known = |&(group, _): &(u32, f64)| {
            groups.kind(group) == Kind::from(mask)
                && shown.of(group) > SLIVER * extents[group as usize]
        };
        let covered: Vec<(u32, f64)> = shown.covered(m).filter(known).collect();
        match covered.len() {
            0 | 1 => pieces.push(Cow::Borrowed(mask)),
            _ => pieces.extend(cut(groups, mask, &covered).into_iter().map(Cow::Owned)),
        }
    }
    pieces
}

/// Pieces of a segment, one for each of the groups that has a Gaussian of it; what none of them has goes to the one that
/// shows most.
fn cut(groups: &Groups, mask: &Mask, covered: &[(u32, f64)]) -> Vec<Mask> {
    let largest = covered.iter().enumerate().fold(
        0,
        |best, (i, c)| if c.1 > covered[best].1 { i } else { best },
    );
    let mut pieces: Vec<Mask> = covered
        .iter()
        .map(|_| Mask {
            segment: mask.segment,
            weights: Vec::new(),
            total: 0.0,
        })
        .collect();
    for &(gaussian, weight) in &mask.weights {
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
