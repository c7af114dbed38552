//! The assignment problem: partners one to one, the sum of their values as large as it can be.

/// For each row of `values` (`[rows, columns]` row-major, finite, at least 0) its column, so that no column is taken
/// twice and the sum of the values taken is largest. Pairs of value 0 are no pairs; rows may stay alone.
///
/// Kuhn-Munkres by shortest augmenting paths with potentials (Jonker and Volgenant, "A shortest augmenting path algorithm
/// for dense and sparse linear assignment problems", 1987): O(rows^2 columns), rows being the shorter side. Among equal
/// sums the answer is a fixed one.
///
/// # Panics
/// If `values` is no multiple of `columns`.
pub fn assignment(values: &[f64], columns: usize) -> Vec<Option<usize>> {
    let rows = values.len() / columns.max(1);
    assert_eq!(values.len(), rows * columns, "assignment: values against rows times columns");
    if rows <= columns {
        let cost = |r: usize, c: usize| -values[r * columns + c];
        let partners = augment(rows, columns, cost);
        return (0..rows).zip(partners).map(|(r, c)| (values[r * columns + c] > 0.0).then_some(c)).collect();
    }
    let cost = |c: usize, r: usize| -values[r * columns + c];
    let mut out = vec![None; rows];
    for (c, r) in augment(columns, rows, cost).into_iter().enumerate() {
        if values[r * columns + c] > 0.0 {
            out[r] = Some(c);
        }
    }
    out
}

/// Column of each row at the least cost; `rows <= columns`.
fn augment(rows: usize, columns: usize, cost: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    const FREE: usize = usize::MAX;
    // The last column is a stand-in that holds the row to be placed.
    let root = columns;
    let mut row_of = vec![FREE; columns + 1];
    let (mut row_potential, mut column_potential) = (vec![0.0; rows], vec![0.0; columns + 1]);
    for row in 0..rows {
        row_of[root] = row;
        let mut at = root;
        let mut slack = vec![f64::INFINITY; columns];
        let mut before = vec![root; columns];
        let mut done = vec![false; columns + 1];
        while row_of[at] != FREE {
            done[at] = true;
            let r = row_of[at];
            let (mut least, mut next) = (f64::INFINITY, root);
            for c in (0..columns).filter(|&c| !done[c]) {
                let reduced = cost(r, c) - row_potential[r] - column_potential[c];
                if reduced < slack[c] {
                    (slack[c], before[c]) = (reduced, at);
                }
                if slack[c] < least {
                    (least, next) = (slack[c], c);
                }
            }
            for c in 0..=columns {
                if done[c] {
                    row_potential[row_of[c]] += least;
                    column_potential[c] -= least;
                } else if c < columns {
                    slack[c] -= least;
                }
            }
            at = next;
        }
        while at != root {
            let previous = before[at];
            row_of[at] = row_of[previous];
            at = previous;
        }
    }
    let mut out = vec![0; rows];
    for (c, &r) in row_of[..columns].iter().enumerate().filter(|(_, r)| **r != FREE) {
        out[r] = c;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};
    use rand::Rng;

    /// The largest sum over all ways to pair rows from `row` on.
    fn best(values: &[f64], columns: usize, row: usize, taken: &mut Vec<bool>) -> f64 {
        if row * columns >= values.len() {
            return 0.0;
        }
        let mut most = best(values, columns, row + 1, taken);
        for c in 0..columns {
            if !taken[c] {
                taken[c] = true;
                most = most.max(values[row * columns + c] + best(values, columns, row + 1, taken));
                taken[c] = false;
            }
        }
        most
    }

    #[test]
    fn no_other_pairing_is_worth_more() {
        let mut rng = stream(5, Purpose::Benchmark, 0);
        for case in 0..300 {
            let (rows, columns) = (rng.random_range(1..7), rng.random_range(1..7));
            // Whole numbers make ties, a threshold makes pairs that are none.
            let draw = |rng: &mut rand_chacha::ChaCha8Rng| match case % 3 {
                0 => rng.random::<f64>(),
                1 => f64::from(rng.random_range(0..4)),
                _ => (rng.random::<f64>() - 0.7).max(0.0),
            };
            let values: Vec<f64> = (0..rows * columns).map(|_| draw(&mut rng)).collect();
            let found = assignment(&values, columns);
            let mut used: Vec<usize> = found.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), found.iter().flatten().count(), "a column twice: {found:?}");
            let pairs = found.iter().enumerate().filter_map(|(r, c)| Some(values[r * columns + (*c)?]));
            assert!(pairs.clone().all(|v| v > 0.0));
            let most = best(&values, columns, 0, &mut vec![false; columns]);
            assert!((pairs.sum::<f64>() - most).abs() < 1e-12, "{values:?} {columns}: {found:?}, {most}");
        }
    }

    #[test]
    fn degenerate_sizes() {
        assert!(assignment(&[], 0).is_empty());
        assert!(assignment(&[], 4).is_empty());
        assert_eq!(assignment(&[0.0; 6], 2), [None; 3]);
        assert_eq!(assignment(&[0.0, 2.0, 3.0, 4.0], 2), [Some(1), Some(0)]);
    }
}
