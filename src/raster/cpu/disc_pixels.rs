//! Algorithm 1's counter: pixels within a radius.

use crate::backend::elementary::floor;

/// Number of pixels of an image `[width, height]` whose centres lie within `radius` of the point [x, y].
///
/// `before` leaves out pixels that are not used. It is `[height, width + 1]`: in each row, the number of used pixels before each
/// column, and at the end the number in the whole row.
pub(super) fn count(
    [x, y]: [f64; 2],
    radius: u32,
    [width, height]: [usize; 2],
    before: Option<&[u32]>,
) -> u32 {
    let r = f64::from(radius);
    let mut sum = 0;
    let (mut row, last) = within(y - r, y + r, height as f64);
    while row <= last {
        let dy = row + 0.5 - y;
        let half = (r * r - dy * dy).max(0.0).sqrt();
        let (left, right) = within(x - half, x + half, width as f64);
        if left <= right {
            sum += match before {
                Some(before) => {
                    let before = &before[row as usize * (width + 1)..];
                    before[right as usize + 1] - before[left as usize]
                }
                None => (right - left + 1.0) as u32,
            };
        }
        row += 1.0;
    }
    sum
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
    use super::count;

    #[test]
    fn used_pixels_are_counted_alone() {
        let size = [131, 97];
        let disc = |i: usize| {
            let x = 170.0 * (1.3 * i as f64).sin();
            ([x, 0.5 * (i % 300) as f64 - 20.0], (i % 67) as u32)
        };
        let counts = |before: Option<&[u32]>| -> Vec<u32> {
            (0..2_000)
                .map(|i| count(disc(i).0, disc(i).1, size, before))
                .collect()
        };
        let plain = counts(None);
        // Where all pixels are used, and where every other one is.
        let before: Vec<u32> = (0..97).flat_map(|_| 0..=131).collect();
        assert_eq!(counts(Some(&before)), plain);
        let [a, b] = [0, 1].map(|even| {
            let before: Vec<u32> = (0..97)
                .flat_map(|_| (0..=131).map(|x| (x + even) / 2))
                .collect();
            counts(Some(&before))
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
