//! The largest of some values, as of the scores of classes.

/// Index of the largest value, the first on ties; `None` if there are none.
pub(crate) fn first_largest<T: PartialOrd>(values: impl IntoIterator<Item = T>) -> Option<usize> {
    let larger = |best: (usize, T), other: (usize, T)| if other.1 > best.1 { other } else { best };
    let best = values.into_iter().enumerate().reduce(larger);
    best.map(|(place, _)| place)
}

/// Class of the largest score in `row`, the first on ties; `None` if no score is above 0.
pub(crate) fn winner<T: PartialOrd + Default>(row: &[T]) -> Option<usize> {
    first_largest(row).filter(|&class| row[class] > T::default())
}
