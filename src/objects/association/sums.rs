//! Sparse sums.

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
}
