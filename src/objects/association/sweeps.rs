//! Passes over the views that form the groups.

use super::divide::divided;
use super::groups::{Groups, Leftovers, Placed};
use super::masks::{Mask, Masks};
use super::merge;
use super::order::overlapping_order;
use super::split::split;
use super::territory::{Shown, extents};
use super::{End, Look};
use crate::config::AssociationConfig;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashMap;

/// Forms the groups of `views`, and says which group each segment belongs to. `look` is told of each view in each sweep.
///
/// # Errors
/// [`crate::Error::Config`] when no group is left; those of `look`.
pub(super) fn group<'a, B>(
    groups: &mut Groups,
    views: &'a [Masks],
    config: &AssociationConfig,
    look: &mut Look<'_, B>,
) -> Result<Vec<Placed<'a>>, End<B>> {
    let order = overlapping_order(views, groups.owners().len());
    let mut placed = vec![Placed::default(); views.len()];
    let mut sizes = Vec::new();
    for sweep in 0..config.sweeps {
        for &v in &order {
            groups.remove(&placed[v]);
            placed[v] = match sweep {
                // Nothing is known yet of what a segment may cover.
                0 => groups.place(
                    whole(&views[v]),
                    config.min_overlap,
                    Leftovers {
                        join: false,
                        open: true,
                    },
                ),
                _ => {
                    let pieces = divided(groups, &views[v], &sizes);
                    groups.place(
                        pieces,
                        config.min_overlap,
                        Leftovers {
                            join: true,
                            open: true,
                        },
                    )
                }
            };
            sizes.resize(groups.len(), 0.0);
            groups.add(&placed[v]);
            look(1)?;
        }
        rebuild(groups, &placed);
        if split(groups, views, &mut placed, &order, config.merge_above, look)? {
            rebuild(groups, &placed);
        }
        sizes = loop {
            look(0)?;
            let shown: Vec<Shown> = views
                .par_iter()
                .map(|view| Shown::new(groups, view))
                .collect();
            let pairs = merge::pairs(groups, &shown, config.merge_above);
            if pairs.is_empty() {
                break extents(groups.len(), &shown);
            }
            let into: HashMap<u32, u32> = pairs.into_iter().collect();
            for group in placed
                .iter_mut()
                .flat_map(|placed| &mut placed.groups)
                .flatten()
            {
                *group = into.get(group).copied().unwrap_or(*group);
            }
            rebuild(groups, &placed);
        };
    }
    let negligible = merge::negligible(groups, config.min_weight)?;
    for group in placed.iter_mut().flat_map(|placed| &mut placed.groups) {
        *group = group.filter(|group| !negligible[*group as usize]);
    }
    rebuild(groups, &placed);
    for Placed {
        masks,
        groups: assigned,
    } in &mut placed
    {
        let overlaps = groups.overlaps(masks);
        for ((mask, claimed), group) in masks.iter().zip(&overlaps.claimed).zip(assigned) {
            *group = group.or_else(|| groups.container(mask, claimed));
        }
    }
    rebuild(groups, &placed);
    Ok(placed)
}

/// Places the segments of a view that had no part in the groups.
pub(super) fn place<'a>(
    groups: &mut Groups,
    view: &'a Masks,
    sizes: &[f64],
    least: f64,
) -> Placed<'a> {
    groups.place(
        divided(groups, view, sizes),
        least,
        Leftovers {
            join: true,
            open: false,
        },
    )
}

fn whole(view: &Masks) -> Vec<Cow<'_, Mask>> {
    view.segments.iter().map(Cow::Borrowed).collect()
}

/// Sums the weights of all groups afresh: the same bits in whichever order views came and went.
fn rebuild(groups: &mut Groups, placed: &[Placed<'_>]) {
    groups.clear();
    placed.iter().for_each(|placed| groups.add(placed));
}
