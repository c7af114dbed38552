//! The assignment problem: partners one to one, the sum of their values as large as it can be.

use pathfinding::prelude::{Matrix, kuhn_munkres};

/// For each row of `values` (`[rows, columns]` row-major, at least 0) its column, so that no column is taken twice and the
/// sum of the values taken is largest. Pairs of value 0 are not assigned, so a row may stay without a column. Ties are broken
/// deterministically.
pub fn assignment(values: &[i64], columns: usize) -> Vec<Option<usize>> {
    let rows = values.len() / columns.max(1);
    let mut partners = vec![None; rows];
    let Ok(matrix) = Matrix::from_vec(rows, columns, values.to_vec()) else {
        return partners;
    };
    // The algorithm needs as many columns as rows.
    if rows <= columns {
        let (_, found) = kuhn_munkres(&matrix);
        found
            .into_iter()
            .enumerate()
            .for_each(|(row, column)| partners[row] = Some(column));
    } else {
        let (_, found) = kuhn_munkres(&matrix.transposed());
        found
            .into_iter()
            .enumerate()
            .for_each(|(column, row)| partners[row] = Some(column));
    }
    let is_pair = |row: usize, column: usize| values[row * columns + column] > 0;
    for (row, partner) in partners.iter_mut().enumerate() {
        *partner = partner.filter(|column| is_pair(row, *column));
    }
    partners
}
