//! Labels of a finished run that a person corrected in its page, to be trained on.

use super::{ObjectScene, RunFolder, SCENE, read_scene};
use crate::config::Config;
use crate::error::{Result, ensure};
use crate::files::sha256;
use crate::objects::{Corrections, Editing, Edits, Operation};
use crate::pipeline::{store_corrections, stored_corrections};
use std::path::Path;

/// Adds the labels of the file `edits` to the corrections of `run`, in which stage two then begins anew by `config`. Returns the
/// number of Gaussians that have corrected labels now. Edits that delete or move Gaussians are left out, with a warning: the photos show
/// things where they were.
///
/// # Errors
/// As [`Edits::read`], [`Edits::apply`] and [`Corrections::check_classes`]; [`crate::Error::Input`] for edits that give no Gaussian a
/// label, and for earlier corrections of other Gaussians; [`crate::Error::Config`] where nothing is to be trained.
pub fn correct(run: &RunFolder, edits: &Path, config: &Config) -> Result<usize> {
    ensure!(config.segmentation.rows.as_ref().is_none_or(|rows| !rows.is_empty()),
        setting "segmentation.rows"; found "[]"; expected "a variant that learns the corrected labels";
        help "add --set segmentation.rows=ours");
    let path = run.file(SCENE);
    let scene = ObjectScene::or_unlabelled(path.clone(), read_scene(&path)?, None)?;
    let file = Edits::read(edits)?;
    let gaussians = &scene.ply.gaussians;
    let mut editing = Editing::new(gaussians.clone(), scene.labels, scene.classes.clone());
    file.apply(&mut editing, &sha256(&path)?, scene.ply.origin)?;
    ensure!(editing.relabelled().next().is_some(), edits, "operations"; found "none that gives a Gaussian a label";
        expected "an assignment or a merge"; help "names and colours alone need no training: apply them with `coseg edit --edits`");
    let moves_or_deletes = |operation: &Operation| {
        use Operation::{DeleteGaussians, DeleteObjects, Move};
        matches!(
            operation,
            DeleteGaussians { .. } | DeleteObjects { .. } | Move { .. }
        )
    };
    if file.operations.iter().any(moves_or_deletes) {
        tracing::warn!(
            "{}: deletions and moves are left out, as the photos show things where they were. Make them again in the page of the new \
             result",
            edits.display()
        );
    }
    let mut corrections = match stored_corrections(run.path())? {
        Some(earlier) => earlier,
        None => Corrections::none(gaussians, &scene.classes),
    };
    corrections.check_gaussians(gaussians, run.path())?;
    corrections.add(&editing);
    corrections.check_classes(edits)?;
    store_corrections(&corrections, run.path())?;
    Ok(corrections.count())
}
