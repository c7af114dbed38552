//! The labels that somebody gave to shapes.

use super::Vocabulary;
use super::drawing::{Drawing, Region};
use crate::data::Classes;
use crate::data::labels::classes::{is_void, plain};
use crate::error::{Result, ensure};
use crate::files::check_limit;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Names of LabelMe and CVAT for pixels without a label.
const UNLABELLED_NAMES: [&str; 2] = ["__ignore__", "_background_"];

/// Classes of a table.
const MAX_LABELS: u64 = u16::MAX as u64 - 1;

/// Labels of shapes, as classes.
pub(super) struct ShapeLabels {
    pub vocabulary: Vocabulary,
    /// Index of each label in the vocabulary.
    places: HashMap<String, usize>,
}

impl ShapeLabels {
    /// The `labels` of the shapes in `file`, for a scene with the class table `classes`.
    ///
    /// # Errors
    /// None of them means a class, or none is in the table.
    pub fn new<'a>(
        file: &Path,
        classes: &Classes,
        labels: impl Iterator<Item = &'a str>,
    ) -> Result<Self> {
        let is_unlabelled =
            |label: &str| is_void(label) || UNLABELLED_NAMES.contains(&label.trim());
        let labels: BTreeMap<String, &str> = labels
            .filter(|label| !is_unlabelled(label))
            .map(|label| (plain(label), label.trim()))
            .collect();
        ensure!(!labels.is_empty(),
            file, "shapes"; found "none with a label"; expected "the outlines of objects, with their classes";
            help "draw polygons and save them");
        let count = labels.len() as u64;
        check_limit(file, "labels", count, MAX_LABELS, "use fewer labels")?;
        Ok(Self {
            vocabulary: Vocabulary::new(file, classes, (1..).zip(labels.values().copied()))?,
            places: labels.into_keys().zip(0..).collect(),
        })
    }

    /// Puts a region with a label, which may mean unlabelled, over the earlier ones of `drawing`.
    pub fn draw(
        &self,
        drawing: &mut Drawing,
        label: &str,
        group: Option<String>,
        region: Region,
    ) -> Result<()> {
        let class = self.places.get(&plain(label)).copied();
        drawing.add(&self.vocabulary, class, group, region)
    }
}
