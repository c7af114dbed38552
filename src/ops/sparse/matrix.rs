//! Constant sparse matrices in compressed rows.

use super::gpu::DeviceMatrix;
use crate::backend::Resident;

/// A constant sparse matrix in compressed rows, `[rows, columns]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseMatrix {
    // Never changed: a device may hold copies.
    pub(crate) columns: usize,
    /// Start of each row in `indices`; `rows + 1` entries, the first 0, ascending.
    pub(crate) offsets: Vec<u32>,
    /// Column of each entry.
    pub(crate) indices: Vec<u32>,
    /// Value of each entry.
    pub(crate) values: Vec<f32>,
    /// Its copy on a device, and that of its transpose.
    pub(super) by_rows: Resident<DeviceMatrix>,
    pub(super) by_columns: Resident<DeviceMatrix>,
}

impl SparseMatrix {
    /// A matrix from compressed rows: `offsets` holds the start of each row in `indices`, and the end of the last.
    ///
    /// # Panics
    /// If `offsets` does not rise from 0 to the number of entries, `indices` and `values` differ in length, or an index is
    /// not below `columns`.
    pub fn new(columns: usize, offsets: Vec<u32>, indices: Vec<u32>, values: Vec<f32>) -> Self {
        assert_eq!(
            indices.len(),
            values.len(),
            "sparse matrix: indices against values"
        );
        let (first, last) = (
            offsets.first().map(|&o| o as usize),
            offsets.last().map(|&o| o as usize),
        );
        assert_eq!(
            (first, last),
            (Some(0), Some(indices.len())),
            "sparse matrix: offsets against entries"
        );
        assert!(offsets.is_sorted(), "sparse matrix: offsets that fall");
        assert!(
            indices.iter().all(|&i| (i as usize) < columns),
            "sparse matrix: an index is not below {columns}"
        );
        Self::unchecked(columns, offsets, indices, values)
    }

    /// [`SparseMatrix::new`] without checks, for arrays that are valid by construction.
    pub(crate) fn unchecked(
        columns: usize,
        offsets: Vec<u32>,
        indices: Vec<u32>,
        values: Vec<f32>,
    ) -> Self {
        Self {
            columns,
            offsets,
            indices,
            values,
            by_rows: Resident::default(),
            by_columns: Resident::default(),
        }
    }

    /// Selects the rows `rows` of an input with `columns` rows, in that order.
    ///
    /// # Panics
    /// If a row is not below `columns`.
    pub fn selection(rows: Vec<u32>, columns: usize) -> Self {
        Self::row_sums(rows, 1, columns)
    }

    /// Sums `k` rows of an input with `columns` rows: row r sums the rows `rows[r k..(r + 1) k]`.
    ///
    /// # Panics
    /// If a row is not below `columns`.
    pub fn row_sums(rows: Vec<u32>, k: usize, columns: usize) -> Self {
        let offsets = (0..=rows.len() as u32).step_by(k.max(1)).collect();
        let ones = vec![1.0; rows.len()];
        Self::new(columns, offsets, rows, ones)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Columns and values of all entries, row by row.
    pub fn entries(&self) -> (&[u32], &[f32]) {
        (&self.indices, &self.values)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Entries of row `r` as (columns, values).
    pub fn row(&self, r: usize) -> (&[u32], &[f32]) {
        let span = self.offsets[r] as usize..self.offsets[r + 1] as usize;
        (&self.indices[span.clone()], &self.values[span])
    }

    /// The same matrix with each row divided by its sum. Blending weights, whose rows sum to `1 - T`, become weighted means.
    #[must_use]
    pub fn normalised(mut self) -> Self {
        for ends in self.offsets.windows(2) {
            let row = &mut self.values[ends[0] as usize..ends[1] as usize];
            let sum: f32 = row.iter().sum();
            if sum > 0.0 {
                row.iter_mut().for_each(|value| *value /= sum);
            }
        }
        self
    }

    /// The rows `rows` in that order.
    #[must_use]
    pub fn select_rows(&self, rows: &[u32]) -> Self {
        let entries = rows.iter().map(|&r| self.row(r as usize).0.len()).sum();
        let mut offsets = Vec::with_capacity(rows.len() + 1);
        let mut indices = Vec::with_capacity(entries);
        let mut values = Vec::with_capacity(entries);
        offsets.push(0);
        for &r in rows {
            let (columns, of_row) = self.row(r as usize);
            indices.extend_from_slice(columns);
            values.extend_from_slice(of_row);
            offsets.push(indices.len() as u32);
        }
        Self::unchecked(self.columns, offsets, indices, values)
    }

    /// The same rows for inputs of `classes` channels laid side by side, `[columns classes, 1]`: row r reads channel
    /// `channels[r]` alone.
    #[must_use]
    pub(crate) fn of_channels(&self, channels: &[u16], classes: usize) -> Self {
        let mut indices = Vec::with_capacity(self.indices.len());
        for (r, &channel) in channels.iter().enumerate() {
            let read = |&column: &u32| column * classes as u32 + u32::from(channel);
            indices.extend(self.row(r).0.iter().map(read));
        }
        let offsets = self.offsets.clone();
        let values = self.values.clone();
        Self::unchecked(self.columns * classes, offsets, indices, values)
    }

    /// The matrix over `columns` (ascending, below [`SparseMatrix::columns`]) alone. Of equal ones it reads the last.
    ///
    /// # Panics
    /// If an entry lies in another column.
    #[must_use]
    pub fn over_columns(mut self, columns: &[u32]) -> Self {
        let mut place = vec![u32::MAX; self.columns];
        for (i, &c) in columns.iter().enumerate() {
            place[c as usize] = i as u32;
        }
        for c in &mut self.indices {
            *c = place[*c as usize];
        }
        assert!(
            !self.indices.contains(&u32::MAX),
            "over_columns: an entry in a column that is left out"
        );
        Self::unchecked(columns.len(), self.offsets, self.indices, self.values)
    }

    /// The transposed matrix; the entries of its rows ascend.
    #[must_use]
    pub fn transposed(&self) -> Self {
        let mut offsets = vec![0_u32; self.columns + 1];
        for &c in &self.indices {
            offsets[c as usize + 1] += 1;
        }
        for c in 0..self.columns {
            offsets[c + 1] += offsets[c];
        }
        let mut next = offsets.clone();
        let mut indices = vec![0; self.indices.len()];
        let mut values = vec![0.0; self.values.len()];
        for r in 0..self.rows() {
            let (columns, row) = self.row(r);
            for (&c, &v) in columns.iter().zip(row) {
                let at = next[c as usize] as usize;
                (indices[at], values[at]) = (r as u32, v);
                next[c as usize] += 1;
            }
        }
        Self::unchecked(self.rows(), offsets, indices, values)
    }
}
