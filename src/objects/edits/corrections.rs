//! Labels of Gaussians that a person corrected, which training takes as true.

use super::Editing;
use crate::checkpoint::Checkpoint;
use crate::data::{Classes, LabelRuns, View};
use crate::error::{Result, ensure};
use crate::objects::LabelMaps;
use crate::raster::{Settings, SplatTensors};
use crate::splat::{Gaussians, bounds};
use glam::{DVec3, Vec3};
use std::path::Path;

const KIND: &str = "corrections";
/// What the file holds for a Gaussian whose label nobody set; ids are below.
const NOT_SET: u32 = u32::MAX;
/// How far a Gaussian may lie from where it was corrected, in diagonals of the scene: files round positions.
const SAME_PLACE: f64 = 1e-4;

/// Labels that a person gave to Gaussians, and the class table with the names and colours of that person.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrections {
    /// The label id of each Gaussian, where a person set it.
    labels: Vec<Option<u16>>,
    /// Where the Gaussians are, relative to the origin of the scene.
    means: Vec<[f32; 3]>,
    /// The class table before the first correction; empty for a scene without labels.
    original: Classes,
    classes: Classes,
}

impl Corrections {
    /// No corrections of the scene `gaussians` with labels of `classes`.
    pub fn none(gaussians: &Gaussians, classes: &Classes) -> Self {
        Self {
            labels: vec![None; gaussians.len()],
            means: gaussians.means.clone(),
            original: classes.clone(),
            classes: classes.clone(),
        }
    }

    /// Adds what `editing` did to the same scene: labels that Gaussians were given, and the class table. A Gaussian that was made
    /// unlabelled is no longer corrected; one that was removed stays as it was.
    ///
    /// # Panics
    /// If the scene has another number of Gaussians.
    pub fn add(&mut self, editing: &Editing) {
        assert_eq!(editing.len(), self.labels.len(), "edits of another scene");
        let ignore = editing.ignore();
        for (row, id) in editing.relabelled() {
            self.labels[row as usize] = (id != ignore).then_some(id);
        }
        self.classes = editing.classes().clone();
    }

    /// Number of Gaussians whose label a person set.
    pub fn count(&self) -> usize {
        self.labels.iter().flatten().count()
    }

    /// The class table.
    pub fn classes(&self) -> &Classes {
        &self.classes
    }

    /// Refuses corrections of one class alone where nothing else is labelled: everything would become that class. `file` holds the
    /// edits that they come from.
    ///
    /// # Errors
    /// [`crate::Error::Input`].
    pub fn check_classes(&self, file: &Path) -> Result<()> {
        let mut ids = self.labels.iter().flatten();
        let first = ids.next();
        let is_enough =
            first.is_none() || !self.original.is_empty() || ids.any(|id| Some(id) != first);
        ensure!(is_enough, file, "operations"; found "one thing alone, {}", self.classes.name(*first.unwrap_or(&0));
            expected "two or more, where photos have no labels";
            help "label something else too, such as what is around it: otherwise everything becomes that thing");
        Ok(())
    }

    /// Refuses Gaussians other than those that were corrected, and a scene with other `classes`. `file` holds the corrections.
    ///
    /// # Errors
    /// [`crate::Error::Input`].
    pub fn check(&self, gaussians: &Gaussians, classes: &Classes, file: &Path) -> Result<()> {
        self.check_gaussians(gaussians, file)?;
        ensure!(classes.has_names_of(&self.original), file, "classes";
            found "corrections of {} classes", self.original.len();
            expected "the {} classes of this scene, with the same names", classes.len();
            help "resume with the data and settings of the run, or train into another folder");
        Ok(())
    }

    /// Refuses Gaussians other than those that were corrected. `file` holds the corrections.
    ///
    /// # Errors
    /// [`crate::Error::Input`].
    pub fn check_gaussians(&self, gaussians: &Gaussians, file: &Path) -> Result<()> {
        const HELP: &str = "resume with the settings of the run, or train into another folder with --scene RUN/scene.ply";
        let (then, now) = (self.means.len(), gaussians.len());
        ensure!(then == now, file, "labels"; found "{then} Gaussians"; expected "the {now} of this run"; help "{HELP}");
        let corners = bounds(gaussians.positions(DVec3::ZERO).into_iter());
        let most = SAME_PLACE * corners.map_or(0.0, |(low, high)| low.distance(high));
        let moved = |(a, b): (&[f32; 3], &[f32; 3])| {
            let distance = Vec3::from(*a)
                .as_dvec3()
                .distance(Vec3::from(*b).as_dvec3());
            distance > most
        };
        let row = self.means.iter().zip(&gaussians.means).position(moved);
        ensure!(row.is_none(), file, "means"; found "row {} at another place", row.unwrap_or_default();
            expected "the Gaussians of this run"; help "{HELP}");
        Ok(())
    }

    /// The maps of corrected labels. Pixels where uncorrected Gaussians weigh more show nothing.
    pub fn maps(&self, min_coverage: f32) -> LabelMaps<'_> {
        let index = |id: &Option<u16>| self.classes.index((*id)?).map(|index| index as u16);
        let labels = self.labels.iter().map(index).collect();
        LabelMaps::of_labels(labels, &self.classes, min_coverage)
    }

    /// Gives `view` its [`View::corrected`] where it shows corrected Gaussians. They are its raw labels too, where it has none.
    ///
    /// # Errors
    /// As [`LabelMaps::of`].
    pub fn correct(
        &self,
        view: &mut View,
        maps: &LabelMaps,
        splats: &SplatTensors,
        settings: &Settings,
    ) -> Result<()> {
        let seen = splats.seen_by(&view.camera, settings);
        let ignore = self.classes.ignore;
        let mut found = maps.of(&seen)?;
        if let Some(mask) = &view.mask {
            mask.fill(&mut found.ids, 1, ignore);
        }
        if found.ids.iter().all(|id| *id == ignore) {
            return Ok(());
        }
        let corrected = LabelRuns::from(found);
        view.raw.get_or_insert_with(|| corrected.clone());
        view.corrected = Some(corrected);
        Ok(())
    }

    /// Makes the corrected labels those of `scores`, `[N, C]` over `classes`, whatever the rows held: probabilities, votes or logits.
    ///
    /// # Panics
    /// If the scores are of another number of Gaussians.
    pub fn fix(&self, scores: &mut [f32], classes: &Classes) {
        if classes.is_empty() {
            return;
        }
        let rows = scores.chunks_exact_mut(classes.len());
        assert_eq!(rows.len(), self.labels.len(), "scores of another scene");
        for (row, id) in rows.zip(&self.labels) {
            let Some(class) = id.and_then(|id| classes.index(id)) else {
                continue;
            };
            let largest = row.iter().copied().fold(1.0, f32::max);
            row.fill(0.0);
            row[class] = largest;
        }
    }

    /// Writes the corrections to `path`.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut file = Checkpoint::new(KIND);
        let labels = self.labels.iter();
        let labels = labels.map(|id| id.map_or(NOT_SET, u32::from)).collect();
        file.put::<u32>("labels", &[self.labels.len()], labels)?;
        let means = self.means.as_flattened().to_vec();
        file.put("means", &[self.means.len(), 3], means)?;
        file.set("original", &self.original)?;
        file.set("classes", &self.classes)?;
        file.save(path)
    }

    /// Reads what [`Self::write`] wrote; `None` if there is no such file.
    ///
    /// # Errors
    /// As [`Checkpoint::load`] and [`Checkpoint::take`]; [`crate::Error::Input`] for a label that is not a class.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        if !path.is_file() {
            return Ok(None);
        }
        let mut file = Checkpoint::load(path, KIND)?;
        let original = file.get("original")?;
        let classes: Classes = file.get("classes")?;
        let count = file.shape("labels")?.iter().product();
        let stored: Vec<u32> = file.take("labels", &[count])?;
        let means: Vec<f32> = file.take("means", &[count, 3])?;
        let mut labels = Vec::with_capacity(count);
        for id in stored {
            let label = u16::try_from(id)
                .ok()
                .filter(|id| classes.index(*id).is_some());
            if id != NOT_SET && label.is_none() {
                return Err(file.wrong("tensor labels", id.to_string(), "ids of the class table"));
            }
            labels.push(label);
        }
        Ok(Some(Self {
            labels,
            means: means.as_chunks().0.to_vec(),
            original,
            classes,
        }))
    }
}
