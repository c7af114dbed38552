//! Label maps compressed to runs of equal ids.

use crate::data::LabelMap;
use serde::{Deserialize, Serialize};

/// A label map as runs of equal ids, `[H, W]` row-major. Neighbouring pixels mostly agree, and runs decode much faster than an
/// image file. Where no neighbours agree, runs take twice the memory of the ids.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LabelRuns {
    width: usize,
    height: usize,
    /// Id and length of each run. Runs of more than 65,535 pixels are stored as several.
    runs: Box<[(u16, u16)]>,
}

impl LabelRuns {
    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Id and length of each run, in row-major order. Neighbouring runs may have the same id.
    pub fn runs(&self) -> impl Iterator<Item = (u16, usize)> {
        self.runs
            .iter()
            .map(|&(id, length)| (id, usize::from(length)))
    }

    /// The map.
    pub fn map(&self) -> LabelMap {
        let mut ids = Vec::with_capacity(self.width * self.height);
        for (id, length) in self.runs() {
            ids.resize(ids.len() + length, id);
        }
        LabelMap {
            width: self.width,
            height: self.height,
            ids,
        }
    }
}

impl From<LabelMap> for LabelRuns {
    fn from(map: LabelMap) -> Self {
        let LabelMap { width, height, ids } = map;
        let longest = usize::from(u16::MAX);
        let of_equal = ids
            .chunk_by(|a, b| a == b)
            .flat_map(|run| run.chunks(longest));
        let runs = of_equal.map(|run| (run[0], run.len() as u16)).collect();
        Self {
            width,
            height,
            runs,
        }
    }
}
