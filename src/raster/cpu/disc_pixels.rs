//! Algorithm 1's counter: pixels within a radius.

use crate::backend::elementary::floor;
use crate::backend::simd::vectorized;

/// Rows of pixels of one loop.
const BLOCK: usize = 8;

/// For each disc, a centre and a radius in pixels, the pixels of an image of `size` whose centres lie in it.
pub(super) fn count(discs: &[([f64; 2], u32)], size: [usize; 2], counts: &mut [u32]) {
    vectorized(
        #[inline(always)]
        || count_all(discs, size, counts),
    )
}

#[inline(always)]
fn count_all(discs: &[([f64; 2], u32)], size: [usize; 2], counts: &mut [u32]) {
    let [width, height] = size.map(|s| s as f64);
    for (count, &([x, y], radius)) in counts.iter_mut().zip(discs) {
        let r = f64::from(radius);
        let (first, last) = within(y - r, y + r, height);
        let mut sum = [0.0; BLOCK];
        let mut row = first;
        while row <= last {
            for (l, sum) in sum.iter_mut().enumerate() {
                let at = row + l as f64;
                let dy = at + 0.5 - y;
                let half = (r * r - dy * dy).max(0.0).sqrt();
                let (left, right) = within(x - half, x + half, width);
                let own = (right - left + 1.0).max(0.0);
                *sum += if at <= last { own } else { 0.0 };
            }
            row += BLOCK as f64;
        }
        // Whole numbers: exact.
        *count = sum.iter().sum::<f64>() as u32;
    }
}

/// [`count`] of the pixels that are used. `before` has for each row of `width` pixels how many of them are used before each pixel,
/// and then their total, `[height, width + 1]`.
pub(super) fn count_used(
    discs: &[([f64; 2], u32)],
    [width, height]: [usize; 2],
    before: &[u32],
    counts: &mut [u32],
) {
    for (count, &([x, y], radius)) in counts.iter_mut().zip(discs) {
        let r = f64::from(radius);
        let (first, last) = within(y - r, y + r, height as f64);
        let mut row = first;
        *count = 0;
        while row <= last {
            let dy = row + 0.5 - y;
            let half = (r * r - dy * dy).max(0.0).sqrt();
            let (left, right) = within(x - half, x + half, width as f64);
            if left <= right {
                let before = &before[row as usize * (width + 1)..];
                *count += before[right as usize + 1] - before[left as usize];
            }
            row += 1.0;
        }
    }
}

/// The first and the last of `limit` pixels whose centres lie within `low..=high`; none where the last comes first.
#[inline(always)]
fn within(low: f64, high: f64, limit: f64) -> (f64, f64) {
    let first = -floor(-(low - 0.5).max(0.0).min(limit));
    let last = floor((high - 0.5).max(-1.0).min(limit - 1.0));
    (first, last)
}

#[cfg(test)]
mod tests {
    use super::{count, count_all, count_used};

    #[test]
    fn wide_instructions_count_the_same() {
        let at = |i: usize| {
            [
                170.0 * (1.3 * i as f64).sin(),
                0.5 * (i % 300) as f64 - 20.0,
            ]
        };
        let discs: Vec<_> = (0..2_000).map(|i| (at(i), (i % 67) as u32)).collect();
        let (mut wide, mut plain) = (vec![0; discs.len()], vec![0; discs.len()]);
        count(&discs, [131, 97], &mut wide);
        count_all(&discs, [131, 97], &mut plain);
        assert_eq!(wide, plain);
        // Where all pixels are used, and where every other one is.
        let before: Vec<u32> = (0..97).flat_map(|_| 0..=131).collect();
        let mut used = vec![0; discs.len()];
        count_used(&discs, [131, 97], &before, &mut used);
        assert_eq!(used, plain);
        let halves = [0, 1].map(|even| -> Vec<u32> {
            (0..97)
                .flat_map(|_| (0..=131).map(|x| (x + even) / 2))
                .collect()
        });
        let [a, b] = halves.map(|before| {
            let mut used = vec![0; discs.len()];
            count_used(&discs, [131, 97], &before, &mut used);
            used
        });
        assert!(
            a.iter()
                .zip(&b)
                .zip(&plain)
                .all(|((a, b), all)| a + b == *all)
        );
        assert!(plain.iter().any(|&count| count > 5_000) && plain.contains(&0));
    }
}
