//! Label maps compressed to runs of equal ids.

use crate::data::LabelMap;

/// A label map as runs of equal ids, `[H, W]` row-major. Neighbouring pixels mostly agree, and runs decode much faster than an
/// image file. Never larger than the map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelRuns {
    width: usize,
    height: usize,
    ids: Ids,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Ids {
    /// Id and length of each run. Runs of more than 65,535 pixels are stored as several.
    Runs(Box<[(u16, u16)]>),
    /// The ids themselves, where runs would take more memory.
    Plain(Box<[u16]>),
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
        let (runs, plain): (&[(u16, u16)], &[u16]) = match &self.ids {
            Ids::Runs(runs) => (runs, &[]),
            Ids::Plain(ids) => (&[], ids),
        };
        let runs = runs.iter().map(|&(id, length)| (id, usize::from(length)));
        runs.chain(plain.iter().map(|&id| (id, 1)))
    }

    /// The map.
    pub fn map(&self) -> LabelMap {
        let mut ids = Vec::with_capacity(self.width * self.height);
        match &self.ids {
            Ids::Runs(runs) => runs
                .iter()
                .for_each(|&(id, n)| ids.resize(ids.len() + usize::from(n), id)),
            Ids::Plain(plain) => ids.extend_from_slice(plain),
        }
        LabelMap {
            width: self.width,
            height: self.height,
            ids,
        }
    }

    /// Bytes that the ids take up.
    pub fn bytes(&self) -> usize {
        match &self.ids {
            Ids::Runs(runs) => size_of_val(&**runs),
            Ids::Plain(ids) => size_of_val(&**ids),
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
        let runs: Vec<(u16, u16)> = of_equal.map(|run| (run[0], run.len() as u16)).collect();
        let ids = if size_of_val(&*runs) < size_of_val(&*ids) {
            Ids::Runs(runs.into())
        } else {
            Ids::Plain(ids.into())
        };
        Self { width, height, ids }
    }
}
