//! One-to-one pairing against all ways to pair.

use coseg::metrics::assignment;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The largest sum over all ways to pair rows from `row` on.
fn best(values: &[i64], columns: usize, row: usize, taken: &mut Vec<bool>) -> i64 {
    if row * columns >= values.len() {
        return 0;
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
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for case in 0..300 {
        let (rows, columns) = (rng.random_range(1..7), rng.random_range(1..7));
        // Whole numbers make ties, a threshold makes pairs that are none.
        let draw = |rng: &mut ChaCha8Rng| match case % 3 {
            0 => rng.random_range(0..1 << 40),
            1 => rng.random_range(0..4),
            _ => rng.random_range(-700..300).max(0),
        };
        let values: Vec<i64> = (0..rows * columns).map(|_| draw(&mut rng)).collect();
        let found = assignment(&values, columns);
        let mut used: Vec<usize> = found.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        assert_eq!(
            used.len(),
            found.iter().flatten().count(),
            "a column twice: {found:?}"
        );
        let pairs = found
            .iter()
            .enumerate()
            .filter_map(|(r, c)| Some(values[r * columns + (*c)?]));
        assert!(pairs.clone().all(|v| v > 0));
        let most = best(&values, columns, 0, &mut vec![false; columns]);
        assert!(
            pairs.sum::<i64>() == most,
            "{values:?} {columns}: {found:?}, {most}"
        );
    }
}

#[test]
fn degenerate_sizes() {
    assert!(assignment(&[], 0).is_empty());
    assert!(assignment(&[], 4).is_empty());
    assert_eq!(assignment(&[0; 6], 2), [None; 3]);
    assert_eq!(assignment(&[0, 2, 3, 4], 2), [Some(1), Some(0)]);
}
