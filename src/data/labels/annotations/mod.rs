//! Label maps as annotations that 2D detectors are trained on: COCO instances, YOLO.

mod coco;
mod yolo;

pub use self::coco::CocoInstances;
pub use self::yolo::Yolo;
use crate::data::Classes;
use std::collections::BTreeMap;

/// The category of each label: its class, or the label itself.
///
/// An object that has a class, such as `chair 2`, is one of the category `chair`. The ignored label has none.
#[derive(Clone, Debug, Default)]
pub struct Categories {
    /// Category id by label id.
    of_labels: BTreeMap<u16, u16>,
    /// Names by category id.
    names: BTreeMap<u16, String>,
}

impl Categories {
    /// The categories of the label ids that occur in a scene.
    pub fn new(classes: &Classes, labels: impl IntoIterator<Item = u16>) -> Self {
        let mut categories = Self::default();
        for label in labels {
            if label == classes.ignore || categories.of_labels.contains_key(&label) {
                continue;
            }
            let name = classes.known_name(label).map(str::to_owned);
            let name = name.unwrap_or_else(|| format!("label {label}"));
            let object = classes.index(label).map(|i| &classes.entries[i]);
            let class =
                object.and_then(|object| Some((object.object_of?.class, object.base_name())));
            let (id, name) = match class {
                Some((class, base)) => (class, base.to_owned()),
                None => (label, name),
            };
            categories.of_labels.insert(label, id);
            categories.names.entry(id).or_insert(name);
        }
        categories
    }
}
