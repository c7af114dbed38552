//! Classes and true labels from before association, which replaces the classes of a scene by objects.

use crate::config::Association;
use crate::data::{Classes, LabelRuns, Scene, Split, View};
use crate::metrics::{SemanticScores, SemanticView, semantic_scores};
use std::collections::{BTreeMap, BTreeSet};

/// Whether labels of `view` can be scored. Class labels need its true labels. Where `association` makes objects of segments, they
/// need true instances or the classes of `semantics`.
pub fn has_truth(view: &View, association: Association, semantics: Option<&Semantics>) -> bool {
    match association {
        Association::None => view.truth.is_some(),
        // No true labels have the ids of objects.
        Association::Gaussians => {
            view.instances.is_some() || semantics.is_some_and(|semantics| semantics.knows(view))
        }
    }
}

/// Classes and true labels of a scene before association, to score objects with classes.
#[derive(Clone, Debug, PartialEq)]
pub struct Semantics {
    /// The class table of the true labels.
    pub classes: Classes,
    /// Ids of the classes of stuff.
    pub stuff: BTreeSet<u16>,
    /// True labels of the test views by their names.
    truth: BTreeMap<String, LabelRuns>,
}

impl Semantics {
    /// From a scene before association. `None` where no segment has a class, or no test view has true labels.
    pub fn of(scene: &Scene) -> Option<Self> {
        let described = || {
            scene
                .views
                .iter()
                .flat_map(|view| &view.segments)
                .filter_map(|s| Some((s.class?, s.thing)))
        };
        let truth: BTreeMap<String, LabelRuns> = scene
            .split(Split::Test)
            .filter_map(|view| Some((view.name.clone(), view.truth.clone()?)))
            .collect();
        let stuff = described()
            .filter(|(_, thing)| !thing)
            .map(|(class, _)| class)
            .collect();
        (described().next().is_some() && !truth.is_empty()).then(|| Self {
            classes: scene.classes.clone(),
            stuff,
            truth,
        })
    }

    /// Whether a view has true labels.
    pub fn knows(&self, view: &View) -> bool {
        self.truth.contains_key(&view.name)
    }

    /// Scores maps of objects in the views that have true labels. `objects` is their class table.
    pub fn score(&self, objects: &Classes, found: &[(&View, LabelRuns)]) -> SemanticScores {
        let maps = found.iter().filter_map(|(view, found)| {
            let truth = self.truth.get(&view.name)?;
            Some((
                truth.map(),
                view.instances.as_ref().map(LabelRuns::map),
                found.map(),
            ))
        });
        let maps: Vec<_> = maps.collect();
        let views = maps.iter().map(|(truth, instances, objects)| {
            let instances = instances.as_ref().map(|map| &map.ids[..]);
            SemanticView {
                truth: &truth.ids,
                instances,
                objects: &objects.ids,
            }
        });
        semantic_scores(objects, &self.classes, &self.stuff, views)
    }
}
