//! Votes of each Gaussian for each class, and what they say.

use crate::backend::device::upload;
use crate::data::winner;
use crate::objects::Identities;
use burn::tensor::{Device, Tensor};

/// Summed weights of each class on each Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct Votes {
    /// `[N, C]` row-major: sum over labelled training pixels of alpha' T where the label is class c.
    pub table: Vec<f32>,
    /// C.
    pub classes: usize,
}

impl Votes {
    /// The votes of each Gaussian.
    pub fn rows(&self) -> std::slice::ChunksExact<'_, f32> {
        self.table.chunks_exact(self.classes.max(1))
    }

    /// The votes on Gaussian `index`.
    pub(in crate::objects) fn row(&self, index: usize) -> &[f32] {
        &self.table[index * self.classes..][..self.classes]
    }

    /// The votes of four parts of the views together.
    ///
    /// # Panics
    /// If they are of other numbers of Gaussians or classes.
    #[must_use]
    pub fn of_all([a, b, c, d]: [&Self; 4]) -> Self {
        for other in [b, c, d] {
            assert_eq!(
                (a.table.len(), a.classes),
                (other.table.len(), other.classes),
                "votes of the same Gaussians for the same classes"
            );
        }
        let first = a.table.iter().zip(&b.table).map(|(a, b)| a + b);
        let second = c.table.iter().zip(&d.table).map(|(c, d)| c + d);
        Self {
            table: first.zip(second).map(|(a, b)| a + b).collect(),
            classes: a.classes,
        }
    }

    /// The votes of each Gaussian, divided by their sum; zeros where nothing was voted.
    #[must_use]
    pub fn shares(&self) -> Self {
        let mut shares = self.clone();
        for row in shares.table.chunks_exact_mut(self.classes.max(1)) {
            let total = row.iter().sum::<f32>().max(f32::MIN_POSITIVE);
            row.iter_mut().for_each(|vote| *vote /= total);
        }
        shares
    }

    /// The columns of the classes `part`, `[N, len]`.
    pub(super) fn of_classes(&self, part: &[u16], device: &Device) -> Tensor<2> {
        let values = self
            .rows()
            .flat_map(|row| part.iter().map(|&class| row[usize::from(class)]));
        let values: Vec<f32> = values.collect();
        let rows = values.len() / part.len();
        upload(values, [rows, part.len()], device)
    }

    /// Class index of each Gaussian's largest vote; `None` where nothing was voted. Ties go to the lower index.
    pub fn winners(&self) -> Vec<Option<u16>> {
        let class = |row| winner(row).map(|class| class as u16);
        self.rows().map(class).collect()
    }

    /// One-hot identities of the winners; zero where nothing was voted.
    pub fn identities(&self) -> Identities {
        let mut scores = vec![0.0; self.table.len()];
        for (row, winner) in scores
            .chunks_exact_mut(self.classes.max(1))
            .zip(self.winners())
        {
            if let Some(c) = winner {
                row[usize::from(c)] = 1.0;
            }
        }
        Identities {
            scores,
            classes: self.classes,
        }
    }

    /// Logarithms of the votes, `[N, C]`, each raised by `pseudo_votes`: logits of a softmax that are the surer, the more votes there
    /// are. Equal in all classes where nothing was voted.
    pub fn logits(&self, pseudo_votes: f32) -> Vec<f32> {
        let votes = self.table.iter();
        votes.map(|vote| (vote + pseudo_votes).ln()).collect()
    }
}
