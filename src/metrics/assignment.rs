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
    let is_turned = rows > columns;
    let matrix = if is_turned {
        matrix.transposed()
    } else {
        matrix
    };
    let (_, found) = kuhn_munkres(&matrix);
    for pair in found.into_iter().enumerate() {
        let (row, column) = if is_turned { (pair.1, pair.0) } else { pair };
        if values[row * columns + column] > 0 {
            partners[row] = Some(column);
        }
    }
    partners
}
