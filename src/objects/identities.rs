//! Segmentation identities stored on the Gaussians (`s_i` of Eq. 3).

use crate::data::{Classes, first_largest};
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

    /// The scores of all Gaussians for the classes `to`, where these are for `from`. A class that `from` lacks is as unlikely as the least
    /// likely one of the Gaussian.
    ///
    /// # Panics
    /// If `from` has another number of classes than the scores.
    #[must_use]
    pub fn for_classes(&self, from: &Classes, to: &Classes) -> Self {
        assert_eq!(from.len(), self.classes, "one class for each score");
        let columns: Vec<_> = from.entries.iter().map(|c| to.index(c.id)).collect();
        let mut scores = Vec::with_capacity(self.scores.len() / self.classes.max(1) * to.len());
        for known in self.scores.chunks_exact(self.classes.max(1)) {
            let lowest = known.iter().copied().fold(f32::INFINITY, f32::min);
            let start = scores.len();
            scores.resize(start + to.len(), lowest);
            for (column, score) in columns.iter().zip(known) {
                if let Some(column) = column {
                    let to: &mut f32 = &mut scores[start + column];
                    *to = to.max(*score);
                }
            }
        }
        Self {
            scores,
            classes: to.len(),
        }
    }

    /// The scores of the Gaussians `rows`, in this order.
    #[must_use]
    pub fn select(&self, rows: &[u32]) -> Self {
        let row = |&row: &u32| &self.scores[row as usize * self.classes..][..self.classes];
        Self {
            scores: rows.iter().flat_map(row).copied().collect(),
            classes: self.classes,
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_without_scores_is_as_unlikely_as_the_least_likely_one() {
        let classes = |ids: &[u16]| Classes::from_names(0, ids.iter().map(|&id| (id, "name")));
        let own = Identities {
            scores: vec![0.7, 0.3, -1.0, -2.0],
            classes: 2,
        };
        let [from, more, fewer] = [classes(&[2, 5]), classes(&[1, 2, 5]), classes(&[5])];
        let wide = own.for_classes(&from, &more);
        assert_eq!(wide.scores, [0.3, 0.7, 0.3, -2.0, -1.0, -2.0]);
        assert_eq!(own.for_classes(&from, &fewer).scores, [0.3, -2.0]);
        assert_eq!(own.for_classes(&from, &from), own);
        assert_eq!(own.select(&[1]).scores, [-1.0, -2.0]);
    }
}
