//! Association: segments whose ids mean something within their view only become segments of one thing.
//!
//! The Gaussians are what views have in common. A segment covers Gaussian i with weight `w_mi = sum_p alpha'_i T_i` over its
//! pixels, and a group of segments with the sum of theirs. Of what a view shows, group g claims `sum_i w_mi W_gi / W_i`
//! pixels of segment m; the IoU of segment and group in these pixels scores the pair. It compares what the view can
//! see, so that a wall of which each view has a part is one wall. Pairs are chosen one to one in each view (as Gaga,
//! arXiv 2404.07977, and CCGS, arXiv 2502.16303, do on sets of points; weights in place of point tests are ours).
//!
//! The first sweep takes the views in an order of overlap and opens groups. Later sweeps take each view out of the groups
//! and assign it again, so that no view confirms itself; then groups that most views take for two are split, groups that
//! most take for one are merged, and at last strays dropped. A segment that covers most of what its view shows of several
//! groups is a segmenter's taking two things for one: since the other views keep these groups apart, it is divided among
//! them, Gaussian by Gaussian and at last pixel by pixel. (MaskClustering, arXiv 2401.07745, also counts the views that
//! agree, and leaves such segments out.)
//! Memory grows with the pairs of segments and Gaussians, 8 bytes each, and 4 more while the order of views is found; not
//! with their product.

mod asked;
mod divide;
mod groups;
mod masks;
mod merge;
mod order;
mod paint;
mod scratch;
mod split;
mod sweeps;
mod territory;

use crate::config::AssociationConfig;
use crate::data::{Class, Classes, LabelRuns, ObjectOf, Scene, Split, View, class_color};
use crate::error::{Error, Result};
use crate::raster::Settings;
use crate::splat::Gaussians;
use groups::{Groups, Kind, Placed};
use masks::{Masks, NOTHING, masks};
use paint::paint;
use scratch::Zeros;
use std::collections::HashMap;
use std::convert::Infallible;
use std::ops::ControlFlow;

/// A thing that segments of several views show.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Id in the maps and in the class table.
    pub id: u16,
    /// Class of its segments, where the segmenter says one.
    pub class: Option<u16>,
    /// Training views with a segment of it.
    pub views: usize,
    /// Sum of alpha' T of its segments, pixels of the training views.
    pub weight: f64,
}

/// Label maps with ids that mean the same in every view.
#[derive(Clone, Debug, PartialEq)]
pub struct Association {
    /// The groups as a class table; id 0 is unlabelled.
    pub classes: Classes,
    /// The groups, ascending by id, largest first.
    pub groups: Vec<Group>,
    /// For each view of the scene, its raw labels in ids of the groups.
    pub maps: Vec<Option<LabelRuns>>,
    /// Segments of the training views.
    pub segments: usize,
    /// Those that belong to no group: their pixels become unlabelled.
    pub dropped: usize,
    /// Those that cover several groups and were divided among them, pixel by pixel.
    pub divided: usize,
}

/// Why an association ended before it was done.
enum End<B> {
    /// Its caller said so.
    Told(B),
    Failed(Error),
}

impl<B> From<Error> for End<B> {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

/// Is told how many more views were looked at, and may end the association.
type Look<'l, B> = dyn FnMut(usize) -> Result<(), End<B>> + 'l;

impl Association {
    /// How many views [`associate_until`] looks at, each as often as it does.
    pub fn looks(scene: &Scene, config: &AssociationConfig) -> usize {
        let [trained, tested] = [Split::Train, Split::Test].map(|split| scene.split(split).count());
        // For their segments, in the sweeps, and to be painted.
        (config.sweeps + 2) * trained + tested
    }

    /// Makes the groups the classes of `scene` and the maps its raw labels. True labels are of other classes and leave
    /// the scene: [`Semantics`](super::Semantics) takes them up before. [`View::instances`] stays to be scored against.
    ///
    /// # Panics
    /// If the scene has another number of views than the one that was associated.
    pub fn apply(self, scene: &mut Scene) {
        assert_eq!(
            self.maps.len(),
            scene.views.len(),
            "association of another scene"
        );
        scene.classes = self.classes;
        for (view, map) in scene.views.iter_mut().zip(self.maps) {
            (view.raw, view.truth) = (map, None);
            view.segments.clear();
        }
    }
}

/// Finds which segments of the raw labels of `scene` show one thing, by way of its Gaussians. Groups come from the
/// training views; raw labels of test views are only told which groups they show.
///
/// Ids are those of [`View::segments`], or of the map itself where it says nothing of them: then all are things without a
/// class. Of stuff all segments of a class are one group.
///
/// # Errors
/// [`Error::NonFinite`] when a Gaussian's parameters are not finite; [`Error::Limit`] for more groups than u16 has ids;
/// [`Error::Config`] when no training view has raw labels, and when no group is left of them.
///
/// # Panics
/// If raw labels are not of the size of their view's camera.
pub fn associate(
    gaussians: &Gaussians,
    scene: &Scene,
    config: &AssociationConfig,
    settings: &Settings,
) -> Result<Association> {
    let go_on = &mut |_: usize| ControlFlow::<Infallible>::Continue(());
    let ControlFlow::Continue(found) = associate_until(gaussians, scene, config, settings, go_on)?;
    Ok(found)
}

/// [`associate`], until `looked` breaks: it is told each time how many more views were looked at, [`Association::looks`] in
/// all, and 0 where it is only asked whether to go on.
///
/// # Errors
/// As [`associate`].
///
/// # Panics
/// As [`associate`].
pub fn associate_until<B>(
    gaussians: &Gaussians,
    scene: &Scene,
    config: &AssociationConfig,
    settings: &Settings,
    looked: &mut dyn FnMut(usize) -> ControlFlow<B>,
) -> Result<ControlFlow<B, Association>> {
    let mut look = |views| match looked(views) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(told) => Err(End::Told(told)),
    };
    match found(gaussians, scene, config, settings, &mut look) {
        Ok(found) => Ok(ControlFlow::Continue(found)),
        Err(End::Told(told)) => Ok(ControlFlow::Break(told)),
        Err(End::Failed(error)) => Err(error),
    }
}

fn found<B>(
    gaussians: &Gaussians,
    scene: &Scene,
    config: &AssociationConfig,
    settings: &Settings,
    look: &mut Look<'_, B>,
) -> Result<Association, End<B>> {
    let zeros = Zeros::new(gaussians.len());
    let raw = |view: &'_ View| match &view.raw {
        Some(raw) => masks(gaussians, view, &raw.map(), settings, &zeros),
        None => Ok(Masks::default()),
    };
    let trained: Vec<usize> = (0..scene.views.len())
        .filter(|&v| scene.views[v].split == Split::Train)
        .collect();
    let mut views = Vec::with_capacity(trained.len());
    for &v in &trained {
        views.push(raw(&scene.views[v])?);
        look(1)?;
    }
    if views.iter().all(|view| view.segments.is_empty()) {
        let expected = "raw labels of training views to put together";
        let help = "add raw labels, or set data.association = \"none\"";
        return Err(Error::config(
            "data.association",
            "gaussians, but no segments",
            expected,
            help,
        )
        .into());
    }
    let mut groups = Groups::new(gaussians.len());
    let placed = sweeps::group(&mut groups, &views, config, look)?;

    let totals = merge::totals(&groups);
    let mut counts = vec![0; groups.len()];
    for placed in &placed {
        let mut present: Vec<u32> = placed.groups.iter().flatten().copied().collect();
        present.sort_unstable();
        present.dedup();
        present
            .into_iter()
            .for_each(|group| counts[group as usize] += 1);
    }
    let mut kept: Vec<u32> = (0..groups.len() as u32)
        .filter(|&g| counts[g as usize] > 0)
        .collect();
    kept.sort_by(|&a, &b| {
        totals[b as usize]
            .0
            .total_cmp(&totals[a as usize].0)
            .then(a.cmp(&b))
    });
    if kept.len() >= usize::from(u16::MAX) {
        return Err(Error::Limit {
            what: "groups of segments".into(),
            found: kept.len().to_string(),
            limit: (u16::MAX - 1).to_string(),
            help: "raise association.min_weight, or give a segmentation of larger things".into(),
        }
        .into());
    }
    let ids: HashMap<u32, u16> = kept.iter().copied().zip(1..).collect();
    let mut maps = vec![None; scene.views.len()];
    let ids = |group: u32| ids.get(&group).copied().unwrap_or(NOTHING);
    for (&v, placed) in trained.iter().zip(&placed) {
        maps[v] = paint(gaussians, &scene.views[v], placed, &ids, settings)?.map(LabelRuns::from);
        look(1)?;
    }
    let sizes = territory::sizes(&groups, &views);
    for (map, view) in maps
        .iter_mut()
        .zip(&scene.views)
        .filter(|(_, view)| view.split == Split::Test)
    {
        let masks = raw(view)?;
        let placed = sweeps::place(&mut groups, &masks, &sizes, config.min_overlap);
        *map = paint(gaussians, view, &placed, &ids, settings)?.map(LabelRuns::from);
        look(1)?;
    }
    let group = |(&g, id)| Group {
        id,
        class: groups.kind(g).class,
        views: counts[g as usize],
        weight: totals[g as usize].0,
    };
    let segments = || placed.iter().flat_map(Placed::by_segment);
    Ok(Association {
        classes: named(kept.iter().map(|&g| groups.kind(g)), &scene.classes),
        groups: kept.iter().zip(1..).map(group).collect(),
        maps,
        segments: segments().count(),
        dropped: segments()
            .filter(|pieces| pieces.iter().all(Option::is_none))
            .count(),
        divided: segments()
            .filter(|pieces| pieces.iter().any(|group| *group != pieces[0]))
            .count(),
    })
}

/// The class table of groups of these kinds: `object 1`, or `chair 2` where the class is known, or `floor` for stuff.
fn named(kinds: impl Iterator<Item = Kind>, classes: &Classes) -> Classes {
    let mut numbers: HashMap<Option<u16>, usize> = HashMap::new();
    let entry = |(kind, id): (Kind, u16)| {
        let name = kind.class.map_or("object", |class| classes.name(class));
        let number = numbers.entry(kind.class).or_default();
        *number += 1;
        let name = if kind.thing {
            format!("{name} {number}")
        } else {
            name.to_owned()
        };
        let object_of = kind.class.map(|class| ObjectOf {
            class,
            thing: kind.thing,
        });
        Class {
            id,
            name,
            color: class_color(id),
            object_of,
        }
    };
    Classes {
        entries: kinds.zip(1..).map(entry).collect(),
        ignore: NOTHING,
    }
}
