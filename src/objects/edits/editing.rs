//! A labelled scene under changes: what `coseg edit` does, by its options or by a file of edits.

use crate::data::{Class, Classes};
use crate::error::{Result, ensure};
use crate::splat::{Gaussians, Motion, bounds, rows_where};
use glam::DVec3;
use std::collections::BTreeSet;

/// The farthest that Gaussians move at once, in diagonals of the scene: positions are f32.
const MAX_MOVE: f64 = 100.0;

/// A scene that is being edited. Its rows stay those of the scene as it was read until [`Editing::finish`].
#[derive(Clone, Debug)]
pub struct Editing {
    gaussians: Gaussians,
    labels: Vec<u16>,
    classes: Classes,
    removed: Vec<bool>,
    /// Gaussians that were given a label.
    relabelled: Vec<bool>,
    /// Labels of the scene as it was.
    used: BTreeSet<u16>,
    farthest: f64,
}

/// What [`Editing::finish`] gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Edited {
    /// The Gaussians that are left, in their order.
    pub gaussians: Gaussians,
    /// One label id for each of them.
    pub labels: Vec<u16>,
    /// The class table; empty where there was none and no edit needed one.
    pub classes: Classes,
}

/// The longest move of Gaussians of a scene, world units; zero where all are at one place.
pub(crate) fn farthest(gaussians: &Gaussians) -> f64 {
    let corners = bounds(gaussians.positions(DVec3::ZERO).into_iter());
    MAX_MOVE * corners.map_or(0.0, |(low, high)| low.distance(high))
}

impl Editing {
    /// Begins with a scene and the table of its labels.
    ///
    /// # Panics
    /// If `labels` does not have one id for each Gaussian.
    pub fn new(gaussians: Gaussians, labels: Vec<u16>, classes: Classes) -> Self {
        assert_eq!(labels.len(), gaussians.len(), "one label for each Gaussian");
        Self {
            removed: vec![false; labels.len()],
            relabelled: vec![false; labels.len()],
            used: labels.iter().copied().collect(),
            farthest: farthest(&gaussians),
            gaussians,
            labels,
            classes,
        }
    }

    /// Number of Gaussians of the scene as it was.
    pub fn len(&self) -> usize {
        self.labels.len()
    }

    /// Whether the scene had no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.labels.is_empty()
    }

    /// The label of unlabelled Gaussians.
    pub fn ignore(&self) -> u16 {
        self.classes.ignore
    }

    /// Whether `id` is a label: of the scene as it was, of the class table, or the ignored one.
    pub fn is_known(&self, id: u16) -> bool {
        self.used.contains(&id) || self.classes.index(id).is_some() || id == self.classes.ignore
    }

    /// Whether a Gaussian is removed.
    ///
    /// # Panics
    /// If `row` is not below [`Editing::len`].
    pub fn is_removed(&self, row: u32) -> bool {
        self.removed[row as usize]
    }

    /// The class table as it is now.
    pub fn classes(&self) -> &Classes {
        &self.classes
    }

    /// Gaussians that were given a label and are not removed, ascending, with that label.
    pub fn relabelled(&self) -> impl Iterator<Item = (u32, u16)> {
        let relabelled = self.relabelled.iter().zip(&self.removed);
        let rows = rows_where(relabelled, |(relabelled, removed)| *relabelled && !removed);
        rows.into_iter().map(|row| (row, self.labels[row as usize]))
    }

    /// Gaussians of a label that are not removed, ascending.
    pub fn rows(&self, id: u16) -> Vec<u32> {
        let labelled = self.labels.iter().zip(&self.removed);
        rows_where(labelled, |(&label, removed)| label == id && !removed)
    }

    /// The longest move that [`Editing::displace`] should be asked for, world units: 100 diagonals of the scene. Zero where all
    /// Gaussians are at one place, which bounds nothing.
    pub fn farthest(&self) -> f64 {
        self.farthest
    }

    /// Whether positions keep their digits when they move by `offset`, or turn about a point that far off.
    pub fn is_near(&self, offset: DVec3) -> bool {
        self.farthest <= 0.0 || offset.length() <= self.farthest
    }

    /// Removes Gaussians.
    ///
    /// # Panics
    /// If a row is not below [`Editing::len`].
    pub fn remove(&mut self, rows: &[u32]) {
        for &row in rows {
            self.removed[row as usize] = true;
        }
    }

    /// Gives Gaussians a label.
    ///
    /// # Panics
    /// As [`Editing::remove`].
    pub fn assign(&mut self, rows: &[u32], id: u16) {
        for &row in rows {
            self.labels[row as usize] = id;
            self.relabelled[row as usize] = true;
        }
    }

    /// Moves Gaussians.
    ///
    /// # Panics
    /// As [`Editing::remove`].
    pub fn displace(&mut self, rows: &[u32], motion: &Motion) {
        motion.apply(&mut self.gaussians, rows);
    }

    /// The entry of a label in the class table. Where there is no table yet, all labels get an entry except 0, which means
    /// unlabelled.
    pub fn entry(&mut self, id: u16) -> &mut Class {
        if self.classes.is_empty() {
            self.classes.ignore = 0;
            for &used in self.used.iter().filter(|used| **used != 0) {
                self.classes.entry(used);
            }
        }
        self.classes.entry(id)
    }

    /// The scene without what was removed.
    ///
    /// # Errors
    /// [`crate::Error::Argument`], naming `what` removed them, when no Gaussian is left.
    pub fn finish(self, what: &str) -> Result<Edited> {
        let rows = rows_where(&self.removed, |removed| !removed);
        ensure!(!rows.is_empty(), argument "{what}"; found "no Gaussian left"; expected "one or more";
            help "keep an object, or remove fewer");
        Ok(Edited {
            gaussians: self.gaussians.select(&rows),
            labels: rows.iter().map(|&row| self.labels[row as usize]).collect(),
            classes: self.classes,
        })
    }
}
