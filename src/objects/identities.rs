//! Segmentation identities stored on the Gaussians (`s_i` of Eq. 3).

use super::largest::first_largest;
use crate::data::Classes;
use crate::error::{Result, bail};
use crate::weights::{HostTensor, WeightFile};
use std::path::Path;

/// Name of the tensor in the file.
const SCORES: &str = "scores";

/// One score per Gaussian and class, view-independent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identities {
    /// `[N, C]` row-major: logits, or weights of the vote; all zero where nothing is known.
    pub scores: Vec<f32>,
    /// C.
    pub classes: usize,
}

impl Identities {
    /// Class index of each Gaussian's largest score, `None` where all scores are equal (nothing is known).
    pub fn labels(&self) -> Vec<Option<u16>> {
        self.scores
            .chunks_exact(self.classes.max(1))
            .map(largest)
            .collect()
    }

    /// Class ids of [`Identities::labels`], the ignored id where nothing is known: the PLY's `label` column.
    pub fn ids(&self, classes: &Classes) -> Vec<u16> {
        let id = |c: u16| classes.entries.get(usize::from(c)).map(|c| c.id);
        self.labels()
            .into_iter()
            .map(|c| c.and_then(id).unwrap_or(classes.ignore))
            .collect()
    }

    /// Writes `identities.safetensors`: tensor `scores` `[N, C]` f32, atomically.
    ///
    /// # Errors
    /// [`crate::Error::Io`] when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let scores = HostTensor {
            shape: vec![self.scores.len() / self.classes.max(1), self.classes],
            values: self.scores.clone(),
        };
        WeightFile::write_one(path, SCORES, scores)
    }

    /// Reads what [`Identities::write`] wrote.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] when the file is damaged or has no 2D tensor `scores` of finite
    /// numbers.
    pub fn read(path: &Path) -> Result<Self> {
        const HELP: &str = "write the run again with `coseg train`";
        let mut file = WeightFile::open_sealed(path)?;
        let Some(HostTensor { shape, values }) = file.tensors.remove(SCORES) else {
            bail!(path, "{SCORES}"; found "nothing"; expected "a 2D tensor"; help "{HELP}");
        };
        let [_, classes] = shape[..] else {
            bail!(path, "{SCORES}"; found "shape {shape:?}"; expected "a 2D tensor"; help "{HELP}");
        };
        if let Some(i) = values.iter().position(|score| !score.is_finite()) {
            let row = i / classes;
            bail!(path, "{SCORES}, row {row}"; found "{}", values[i]; expected "finite numbers"; help "{HELP}");
        }
        Ok(Self {
            scores: values,
            classes,
        })
    }
}

/// Index of the largest value; `None` when all are equal. Ties go to the lower index.
pub(super) fn largest(row: &[f32]) -> Option<u16> {
    let best = first_largest(row)?;
    let known = row.len() == 1 || row.iter().any(|v| *v < row[best]);
    known.then_some(best as u16)
}
