//! Cells of a table: the scores of one variant on one scene under one seed, each in a file of its own.

use super::{Figures, LabelKind, SceneFolder, TableRow};
use crate::config::Variant;
use crate::error::{Result, bail, ensure};
use crate::files::{self, atomic};
use crate::metrics::ClassIou;
use crate::provenance::Provenance;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What to do about a file of something else.
pub(super) const HELP: &str = "delete the file to train it again, or choose another --out";

/// Which cell.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CellId {
    /// Name of the scene.
    pub scene: String,
    /// Name of the kind of labels.
    pub labels: String,
    /// Name of the row.
    pub row: String,
    /// Seed of stage two.
    pub seed: u64,
}

impl std::fmt::Display for CellId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{}/{}/{}/{}",
            self.scene, self.labels, self.row, self.seed
        )
    }
}

impl CellId {
    /// The cell of a scene, labels, a row and a seed.
    pub(super) fn new(scene: &SceneFolder, labels: &LabelKind, row: &TableRow, seed: u64) -> Self {
        Self {
            scene: scene.name.clone(),
            labels: labels.name.clone(),
            row: row.name.clone(),
            seed,
        }
    }

    /// The cell's file in the folder `out` of a comparison.
    pub fn file(&self, out: &Path) -> PathBuf {
        let folder = out.join("cells").join(&self.scene).join(&self.labels);
        folder.join(&self.row).join(format!("{}.json", self.seed))
    }
}

/// A finished cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Its position in the table.
    #[serde(flatten)]
    pub id: CellId,
    /// What was trained.
    pub variant: Variant,
    /// Commit of the program.
    pub commit: String,
    /// Command that trained it.
    pub command: String,
    /// Backend and processor threads, in words.
    pub device: String,
    /// What was measured.
    pub figures: Figures,
    /// IoU of each class in the truth, ascending by id.
    pub class_iou: Vec<ClassIou>,
}

/// A cell's file.
#[derive(Serialize, Deserialize)]
struct CellFile {
    #[serde(flatten)]
    cell: Cell,
    provenance: Provenance,
}

/// Writes the file of `cell`, which has `provenance`, in the folder `out` of a comparison.
pub(super) fn write_cell(out: &Path, cell: Cell, provenance: Provenance) -> Result<()> {
    let path = cell.id.file(out);
    atomic::write_json(&path, &CellFile { cell, provenance })
}

/// The finished cell `id` in the folder `out`. Its provenance has to equal `provenance`, and its commit has to equal `commit` if that
/// is given.
///
/// # Errors
/// [`crate::Error::Input`] and [`crate::Error::Config`] naming the file and what differs.
pub(super) fn read_cell(
    out: &Path,
    id: &CellId,
    provenance: &Provenance,
    commit: Option<&str>,
) -> Result<Cell> {
    let path = &id.file(out);
    let stored: CellFile = files::json(path, "a cell of `coseg compare`")?;
    let cell = stored.cell;
    ensure!(cell.id == *id, path, "scene, labels, row, seed"; found "{}", cell.id; expected "{id}"; help "{HELP}");
    provenance.check(&stored.provenance, false, path, Some(HELP))?;
    if let Some(commit) = commit.filter(|commit| *commit != cell.commit) {
        bail!(path, "commit"; found "{}", cell.commit; expected "{commit}, that of this program";
            help "{HELP}, or keep such cells with --keep-cells");
    }
    Ok(cell)
}
