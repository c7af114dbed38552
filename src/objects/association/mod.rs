//! Association: segments of several views that show one object, found through the Gaussians.
//!
//! The ids of segments mean something within their view only. The Gaussians are what views have in common. A segment covers
//! Gaussian i with weight `w_mi = sum_p alpha'_i T_i` over its pixels, and a group of segments with the sum of theirs. Of what a
//! view shows, group g claims `sum_i w_mi W_gi / (W_i + 1)` pixels of segment m. The IoU of segment and group in these pixels scores the
//! pair. It compares only what the view can see. So a wall is one wall even if each view shows a part of it. Pairs are chosen one
//! to one in each view (as Gaga, arXiv 2404.07977, and CCGS, arXiv 2502.16303, do on sets of points; weights in place of point
//! tests are ours).
//!
//! The first sweep takes the views in an order of overlap and opens groups. Later sweeps remove each view from the groups and
//! assign it again, so that no view confirms itself. Then groups that most views take for one object are merged. Strays are dropped
//! last. Where a segment covers most of what its view shows of several groups, the segmenter took two objects for one. The other
//! views keep these groups apart, so the segment is divided among them, Gaussian by Gaussian and then pixel by pixel.
//! (MaskClustering, arXiv 2401.07745, also counts the views that agree, and leaves such segments out.)
//!
//! Memory grows with the pairs of segments and Gaussians, 8 bytes each, and as much again while the order of the views is found.
//! It does not grow with their product.

mod divide;
mod groups;
mod merge;
mod order;
mod ownership;
mod relabel;
mod segments;
mod sums;
mod sweeps;

use crate::data::{Class, Classes, LabelRuns, ObjectOf, Scene, Split, View, class_color};
use crate::error::{Result, bail, ensure};
use crate::raster::Settings;
use crate::splat::Gaussians;
use divide::divided;
use groups::{Assigned, Category, Groups, Unmatched};
use ownership::{extents, sightings_in_views};
use relabel::relabelled;
use segments::{NO_SEGMENT, ViewSegments, view_segments};
use std::collections::{BTreeSet, HashMap};

/// Label maps with ids that mean the same in every view.
#[derive(Clone, Debug, PartialEq)]
pub struct AssociatedObjects {
    /// The groups as a class table, largest first; id 0 is unlabelled.
    pub classes: Classes,
    /// For each view of the scene, its raw labels in ids of the groups.
    pub maps: Vec<Option<LabelRuns>>,
    /// Number of segments in the training views.
    pub segments: usize,
    /// Number of segments without a group: their pixels become unlabelled.
    pub dropped: usize,
    /// Number of segments that cover several groups and were divided among them, pixel by pixel.
    pub divided: usize,
}

/// Receives the number of views done since the last call. Its error ends the association.
type Progress<'p> = dyn FnMut(usize) -> Result<()> + 'p;

impl AssociatedObjects {
    /// Steps of [`associate`] in all: one for each pass over each view.
    pub fn steps(scene: &Scene) -> usize {
        let [train, test] = [Split::Train, Split::Test].map(|split| scene.split(split).count());
        // One pass finds the segments, then come the sweeps, and one pass relabels the maps.
        (sweeps::SWEEPS + 2) * train + test
    }

    /// Makes the groups the classes of `scene` and the maps its raw labels. True labels have other classes and leave the scene:
    /// take [`Semantics`](super::Semantics) before. [`View::instances`] stays, for the scores.
    ///
    /// # Panics
    /// If the scene has a different number of views than the one that was associated.
    pub fn apply(self, scene: &mut Scene) {
        let views = (self.maps.len(), scene.views.len());
        assert_eq!(views.0, views.1, "association of another scene");
        scene.classes = self.classes;
        for (view, map) in scene.views.iter_mut().zip(self.maps) {
            view.raw = map;
            view.truth = None;
            view.scores = None;
            view.segments.clear();
        }
    }
}

/// Finds which segments of the raw labels of `scene` show one object, by the Gaussians that they cover. The training views form the
/// groups. Segments of test views are then assigned to them. `progress` receives the steps done since its last call,
/// [`AssociatedObjects::steps`] in all; 0 only checks whether to go on.
///
/// Ids of segments are those of [`View::segments`]. An id that is not among them is a thing without a class. All segments of a
/// class of stuff are one group.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite; [`crate::Error::Limit`] for more groups than u16 has ids;
/// [`crate::Error::Config`] when no training view has raw labels, and when no group is left of them; those of `progress`.
///
/// # Panics
/// If raw labels have a different size than their view's camera.
pub fn associate(
    gaussians: &Gaussians,
    scene: &Scene,
    settings: &Settings,
    progress: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<AssociatedObjects> {
    let inputs = AssociationInputs {
        gaussians,
        scene,
        settings,
    };
    let mut views = Vec::new();
    for view in scene.split(Split::Train) {
        views.push(inputs.segments(view)?);
        progress(1)?;
    }
    if views.iter().all(|view| view.segments.is_empty()) {
        bail!(setting "data.association"; found "gaussians, but no segments";
            expected "raw labels of training views to put together";
            help "add raw labels, or set data.association = \"none\"");
    }
    let mut groups = Groups::new(gaussians.len());
    let assigned = sweeps::form_groups(&mut groups, &views, progress)?;
    let kept = numbered_groups(&groups, &assigned)?;
    let maps = inputs.maps(&mut groups, &views, &assigned, &kept, progress)?;
    let segments = || {
        let segments = assigned.iter().flat_map(|view| view.by_segment());
        segments.map(|(_, pieces)| pieces)
    };
    let is_dropped = |pieces: &&[Option<u32>]| pieces.iter().all(Option::is_none);
    let is_divided = |pieces: &&[Option<u32>]| pieces.iter().any(|group| *group != pieces[0]);
    let categories = kept.iter().map(|&group| groups.category(group));
    Ok(AssociatedObjects {
        classes: class_table(categories, &scene.classes),
        maps,
        segments: segments().count(),
        dropped: segments().filter(is_dropped).count(),
        divided: segments().filter(is_divided).count(),
    })
}

/// The inputs of an association.
struct AssociationInputs<'a> {
    gaussians: &'a Gaussians,
    scene: &'a Scene,
    settings: &'a Settings,
}

impl AssociationInputs<'_> {
    fn segments(&self, view: &View) -> Result<ViewSegments> {
        match &view.raw {
            Some(raw) => view_segments(self.gaussians, view, &raw.map(), self.settings),
            None => Ok(ViewSegments::default()),
        }
    }

    /// The raw labels of all views in ids of the groups that are `kept`.
    fn maps(
        &self,
        groups: &mut Groups,
        views: &[ViewSegments],
        assigned: &[Assigned<'_>],
        kept: &[u32],
        progress: &mut Progress,
    ) -> Result<Vec<Option<LabelRuns>>> {
        let ids: HashMap<u32, u16> = kept.iter().copied().zip(1..).collect();
        let ids = |group: u32| ids.get(&group).copied().unwrap_or(NO_SEGMENT);
        let extents = extents(groups.len(), &sightings_in_views(groups, views));
        let relabel = |view: &View, assigned: &Assigned<'_>| -> Result<Option<LabelRuns>> {
            let map = relabelled(self.gaussians, view, assigned, &ids, self.settings)?;
            Ok(map.map(LabelRuns::from))
        };
        let mut maps = vec![None; self.scene.views.len()];
        let slots = || (0..).zip(&self.scene.views);
        let trained = slots().filter(|(_, view)| view.split == Split::Train);
        for ((v, view), assigned) in trained.zip(assigned) {
            maps[v] = relabel(view, assigned)?;
            progress(1)?;
        }
        for (v, view) in slots().filter(|(_, view)| view.split == Split::Test) {
            let segments = self.segments(view)?;
            let pieces = divided(groups, &segments, &extents);
            let assigned = groups.assign(pieces, Unmatched::Joins);
            maps[v] = relabel(view, &assigned)?;
            progress(1)?;
        }
        Ok(maps)
    }
}

/// The numbers of the groups that have a segment, largest first.
///
/// # Errors
/// [`crate::Error::Limit`] for more groups than u16 has ids.
fn numbered_groups(groups: &Groups, assigned: &[Assigned<'_>]) -> Result<Vec<u32>> {
    let totals = merge::totals(groups);
    let weight = |group: u32| totals[group as usize].weight;
    let present = assigned.iter().flat_map(|view| &view.groups).flatten();
    let present: BTreeSet<u32> = present.copied().collect();
    let mut kept: Vec<u32> = present.into_iter().collect();
    kept.sort_by(|&a, &b| weight(b).total_cmp(&weight(a)).then(a.cmp(&b)));
    ensure!(kept.len() < usize::from(u16::MAX),
        limit "groups of segments"; found "{}", kept.len(); expected "{}", u16::MAX - 1;
        help "give a segmentation of larger things");
    Ok(kept)
}

/// The class table of groups of these categories: `object 1`, or `chair 2` where the class is known, or `floor` for stuff.
fn class_table(categories: impl Iterator<Item = Category>, classes: &Classes) -> Classes {
    let mut numbers: HashMap<Option<u16>, usize> = HashMap::new();
    let entry = |(category, id): (Category, u16)| {
        let name = category.class.map_or("object", |class| classes.name(class));
        let number = numbers.entry(category.class).or_default();
        *number += 1;
        let name = if category.thing {
            format!("{name} {number}")
        } else {
            name.to_owned()
        };
        let object_of = category.class.map(|class| ObjectOf {
            class,
            thing: category.thing,
        });
        Class {
            id,
            name,
            color: class_color(id),
            object_of,
        }
    };
    Classes {
        entries: categories.zip(1..).map(entry).collect(),
        ignore: NO_SEGMENT,
    }
}
