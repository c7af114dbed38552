//! The largest of some values.

/// The place of the largest value, of equal ones the first; `None` without values.
pub(crate) fn first_largest<T: PartialOrd>(values: impl IntoIterator<Item = T>) -> Option<usize> {
    let larger = |best: (usize, T), other: (usize, T)| if other.1 > best.1 { other } else { best };
    let best = values.into_iter().enumerate().reduce(larger);
    best.map(|(place, _)| place)
}
