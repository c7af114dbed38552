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
    assert_eq!(
        values.len(),
        rows * columns,
        "assignment: values against rows times columns"
    );
    if rows <= columns {
        let cost = |r: usize, c: usize| -values[r * columns + c];
        let partners = augment(rows, columns, cost);
        return (0..rows)
            .zip(partners)
            .map(|(r, c)| (values[r * columns + c] > 0.0).then_some(c))
            .collect();
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
    for (c, &r) in row_of[..columns]
        .iter()
        .enumerate()
        .filter(|(_, r)| **r != FREE)
    {
        out[r] = c;
    }
    out
}
