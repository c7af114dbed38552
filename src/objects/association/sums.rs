//! Sparse sums and sparse rows.

/// Sums by index. The vector is long and mostly zero, so it is kept and used again.
pub(super) struct SparseSums {
    sums: Vec<f64>,
    touched: Vec<u32>,
}

impl SparseSums {
    /// Zero for each of `len` indices.
    pub fn new(len: usize) -> Self {
        Self {
            sums: vec![0.0; len],
            touched: Vec::new(),
        }
    }

    pub fn add(&mut self, index: u32, value: f64) {
        let sum = &mut self.sums[index as usize];
        if *sum == 0.0 {
            self.touched.push(index);
        }
        *sum += value;
    }

    /// The indices with their sums, ascending. All sums are zero afterwards.
    pub fn take(&mut self) -> Vec<(u32, f64)> {
        self.touched.sort_unstable();
        self.touched.dedup();
        let sums = &mut self.sums;
        let taken = |index: u32| (index, std::mem::take(&mut sums[index as usize]));
        self.touched.drain(..).map(taken).collect()
    }
}

/// Compressed sparse rows: values by row, in the order in which they were given.
pub(super) struct SparseRows<T> {
    offsets: Vec<usize>,
    values: Vec<T>,
}

impl<T: Copy + Default> SparseRows<T> {
    /// `entries` are pairs of row and value.
    pub fn new(rows: usize, entries: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut offsets = vec![0_usize; rows + 1];
        for (row, _) in entries.clone() {
            offsets[row as usize + 1] += 1;
        }
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        let mut next = offsets.clone();
        let mut values = vec![T::default(); offsets[rows]];
        for (row, value) in entries {
            values[next[row as usize]] = value;
            next[row as usize] += 1;
        }
        Self { offsets, values }
    }

    pub fn row(&self, row: u32) -> &[T] {
        let row = row as usize;
        &self.values[self.offsets[row]..self.offsets[row + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_sorted_and_zero_afterwards() {
        let mut sums = SparseSums::new(5);
        for (index, value) in [(3, 1.0), (0, 0.0), (0, 0.0), (3, 2.0), (1, 4.0)] {
            sums.add(index, value);
        }
        assert_eq!(sums.take(), [(0, 0.0), (1, 4.0), (3, 3.0)]);
        assert!(sums.take().is_empty() && sums.sums.iter().all(|sum| *sum == 0.0));
    }

    #[test]
    fn rows_keep_the_order_of_their_entries() {
        let entries = [(2, 'a'), (0, 'b'), (2, 'c')];
        let rows = SparseRows::new(3, entries.into_iter());
        assert_eq!(
            [rows.row(0), rows.row(1), rows.row(2)],
            [&['b'][..], &[], &['a', 'c']]
        );
    }
}
