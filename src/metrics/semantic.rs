//! Scores of objects by what they are: mIoU over classes, and panoptic quality of things and stuff.

use super::instances::{Pairs, PanopticQuality, Quality};
use super::labels::{PixelScores, Void, label_scores};
use crate::data::Classes;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Scores of a set of views against true classes, each in 0..1. An object counts as its class.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SemanticScores {
    /// Scores that count pixels.
    #[serde(flatten)]
    pub pixels: PixelScores,
    /// IoU of each class in the truth, all views together, ascending by id.
    pub per_class: Vec<ClassIou>,
    /// Panoptic quality by class, where views have true instances too.
    pub panoptic: Option<PanopticScores>,
}

/// IoU of a class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassIou {
    /// Its id in the class table of the true labels.
    pub id: u16,
    /// Its name there.
    pub name: String,
    /// IoU, 0..1.
    pub iou: f64,
}

/// Panoptic quality as a mean over classes; segments of different classes never match.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PanopticScores {
    /// All classes. Segments match within a view; all views are counted together.
    pub all: Quality,
    /// The classes of things alone.
    pub things: Quality,
    /// The classes of stuff alone.
    pub stuff: Quality,
    /// All classes, with all views as one image: an object that changes its id between views counts as two.
    pub scene: Quality,
}

/// A view to be scored; all maps are `[H, W]`.
#[derive(Clone, Copy, Debug)]
pub struct SemanticView<'a> {
    /// True class ids.
    pub truth: &'a [u16],
    /// True instance ids, 0 is none.
    pub instances: Option<&'a [u16]>,
    /// Ids of objects.
    pub objects: &'a [u16],
}

/// Scores `views`. `objects` gives the class of each object, `classes` is the table of the true labels, and `stuff` names its
/// classes without instances.
///
/// Pixels whose truth is the ignored id are left out. An object without a class is void, which counts as wrong. A true segment is
/// an instance of a class of things, or all pixels of a class of stuff. Pixels of things without an instance have no true segment.
pub fn semantic_scores<'a>(
    objects: &Classes,
    classes: &Classes,
    stuff: &BTreeSet<u16>,
    views: impl IntoIterator<Item = SemanticView<'a>>,
) -> SemanticScores {
    let views: Vec<SemanticView<'_>> = views.into_iter().collect();
    let mut class_of = vec![classes.ignore; 1 << 16];
    for object in &objects.entries {
        if let Some(of) = object.object_of {
            class_of[usize::from(object.id)] = of.class;
        }
    }
    let pairs = views.iter().map(|view| {
        let found = view.objects.iter().map(|&id| class_of[usize::from(id)]);
        (view.truth, found.collect::<Vec<_>>())
    });
    let scores = label_scores(classes, pairs, Void::Wrong);
    SemanticScores {
        pixels: scores.pixels,
        per_class: scores.named(classes),
        panoptic: panoptic(classes, stuff, &class_of, &views),
    }
}

/// Panoptic quality of the views with true instances; `class_of` has the class id of each object.
fn panoptic(
    classes: &Classes,
    stuff: &BTreeSet<u16>,
    class_of: &[u16],
    views: &[SemanticView<'_>],
) -> Option<PanopticScores> {
    let mut segments = Segments::default();
    let mut pooled = Pairs::default();
    let mut each = Vec::new();
    for view in views {
        let Some(instances) = view.instances else {
            continue;
        };
        let known = |class: u16| classes.index(class).is_some();
        let truth: Vec<u16> = view
            .truth
            .iter()
            .zip(instances)
            .map(|(&class, &instance)| {
                let is_stuff = stuff.contains(&class);
                if !known(class) || !is_stuff && instance == 0 {
                    0
                } else {
                    segments.id(class, if is_stuff { 0 } else { instance })
                }
            })
            .collect();
        // Objects without a class show nothing.
        let is_known = |id: u16| known(class_of[usize::from(id)]);
        let shown = view.objects.iter();
        let shown: Vec<u16> = shown.map(|&id| if is_known(id) { id } else { 0 }).collect();
        let pairs = Pairs::of(&truth, &shown);
        pooled.merge(&pairs);
        each.push(pairs);
    }
    let classes_of: [&dyn Fn(u16) -> u16; 2] =
        [&|id| segments.class(id), &|id| class_of[usize::from(id)]];
    let mut quality = PanopticQuality::default();
    let mut scene = PanopticQuality::default();
    each.iter()
        .for_each(|pairs| quality.count(pairs, classes_of));
    scene.count(&pooled, classes_of);
    (!each.is_empty()).then(|| PanopticScores {
        all: quality.quality(),
        things: quality.quality_of(|class| !stuff.contains(&class)),
        stuff: quality.quality_of(|class| stuff.contains(&class)),
        scene: scene.quality(),
    })
}

/// True segments by class and instance, numbered from 1 on as they are met.
#[derive(Default)]
struct Segments {
    ids: BTreeMap<(u16, u16), u16>,
    classes: Vec<u16>,
}

impl Segments {
    /// Its number; 0, which is none, past as many as u16 has.
    fn id(&mut self, class: u16, instance: u16) -> u16 {
        let next = u16::try_from(self.classes.len() + 1).unwrap_or(0);
        let id = *self.ids.entry((class, instance)).or_insert(next);
        if id == next && id > 0 {
            self.classes.push(class);
        }
        id
    }

    fn class(&self, id: u16) -> u16 {
        self.classes[usize::from(id) - 1]
    }
}
