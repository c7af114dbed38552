//! The passes over the views that form the groups.

use super::Progress;
use super::divide::divided;
use super::groups::{Assigned, Groups, Unmatched};
use super::merge;
use super::order::view_order;
use super::ownership::{extents, sightings_in_views};
use super::segments::ViewSegments;
use crate::error::Result;
use std::borrow::Cow;
use std::collections::HashMap;

/// Passes over all views; the first forms groups, the others assign every view again.
pub(super) const SWEEPS: usize = 4;
/// Groups with a smaller share of all labelled weight are dropped, 0 to 1.
const MIN_WEIGHT: f64 = 1e-5;

/// Forms the groups of `views` and returns the group of each segment. Reports each view in each sweep to `progress`.
///
/// # Errors
/// [`crate::Error::Config`] when no group is left; those of `progress`.
pub(super) fn form_groups<'a>(
    groups: &mut Groups,
    views: &'a [ViewSegments],
    progress: &mut Progress,
) -> Result<Vec<Assigned<'a>>> {
    let order = view_order(views, groups.owners().len());
    let mut assigned = vec![Assigned::default(); views.len()];
    let mut group_extents = Vec::new();
    for sweep in 0..SWEEPS {
        for &v in &order {
            groups.remove(&assigned[v]);
            assigned[v] = if sweep == 0 {
                // No group is known yet that a segment may cover.
                let whole = views[v].segments.iter().map(Cow::Borrowed).collect();
                groups.assign(whole, Unmatched::Creates)
            } else {
                let pieces = divided(groups, &views[v], &group_extents);
                groups.assign(pieces, Unmatched::JoinsOrCreates)
            };
            group_extents.resize(groups.len(), 0.0);
            groups.add(&assigned[v]);
            progress(1)?;
        }
        groups.rebuild(&assigned);
        group_extents = merge_groups(groups, views, &mut assigned, progress)?;
    }
    drop_negligible(groups, &mut assigned)?;
    Ok(assigned)
}

/// Merges pairs of groups until the views find no more that are one object. Returns the extents of the groups.
fn merge_groups(
    groups: &mut Groups,
    views: &[ViewSegments],
    assigned: &mut [Assigned<'_>],
    progress: &mut Progress,
) -> Result<Vec<f64>> {
    loop {
        progress(0)?;
        let sightings = sightings_in_views(groups, views);
        let extents = extents(groups.len(), &sightings);
        let pairs = merge::pairs(groups, &sightings, &extents);
        if pairs.is_empty() {
            return Ok(extents);
        }
        let into: HashMap<u32, u32> = pairs.into_iter().collect();
        for group in assigned
            .iter_mut()
            .flat_map(|view| &mut view.groups)
            .flatten()
        {
            *group = into.get(group).copied().unwrap_or(*group);
        }
        groups.rebuild(assigned);
    }
}

/// Drops negligible groups. Their segments go to the groups that contain them.
fn drop_negligible(groups: &mut Groups, assigned: &mut [Assigned<'_>]) -> Result<()> {
    let negligible = merge::negligible(groups, MIN_WEIGHT)?;
    for group in assigned.iter_mut().flat_map(|view| &mut view.groups) {
        *group = group.filter(|group| !negligible[*group as usize]);
    }
    groups.rebuild(assigned);
    for view in assigned.iter_mut() {
        let overlaps = groups.overlaps(&view.pieces);
        let pieces = view.pieces.iter().zip(&overlaps.claimed);
        for ((piece, claimed), group) in pieces.zip(&mut view.groups) {
            *group = group.or_else(|| groups.container(piece, claimed));
        }
    }
    groups.rebuild(assigned);
    Ok(())
}
