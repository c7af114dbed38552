//! Regions as run lengths.

use std::ops::Range;

/// Pixels of a box of a picture, as runs outside and inside in turn.
pub(super) struct Runs {
    /// Size of the picture.
    picture: (usize, usize),
    /// First column and first row of the box.
    corner: (usize, usize),
    /// Size of the box.
    size: (usize, usize),
    /// The runs go along rows, not along columns.
    by_rows: bool,
    /// They fill the box.
    counts: Vec<u64>,
}

impl Runs {
    /// Runs along the columns of a picture of this size, as COCO has them. `None` where they do not fill it.
    pub fn of_columns(picture: (usize, usize), counts: Vec<u64>) -> Option<Self> {
        let (corner, size, by_rows) = ((0, 0), picture, false);
        let runs = Self {
            picture,
            corner,
            size,
            by_rows,
            counts,
        };
        runs.fit().then_some(runs)
    }

    /// Runs along the rows of a box, as CVAT has them. `None` where they do not fill it, or where it is not within the picture.
    pub fn of_rows(
        picture: (usize, usize),
        corner: (usize, usize),
        size: (usize, usize),
        counts: Vec<u64>,
    ) -> Option<Self> {
        let by_rows = true;
        let runs = Self {
            picture,
            corner,
            size,
            by_rows,
            counts,
        };
        runs.fit().then_some(runs)
    }

    fn fit(&self) -> bool {
        let within = |start: usize, length: usize, whole: usize| {
            length > 0 && start.checked_add(length).is_some_and(|end| end <= whole)
        };
        let pixels = (self.size.0 as u64).checked_mul(self.size.1 as u64);
        let mut counts = self.counts.iter();
        within(self.corner.0, self.size.0, self.picture.0)
            && within(self.corner.1, self.size.1, self.picture.1)
            && counts.try_fold(0_u64, |sum, count| sum.checked_add(*count)) == pixels
    }

    /// Pixels inside.
    pub fn area(&self) -> u64 {
        self.counts.iter().skip(1).step_by(2).sum()
    }

    /// Calls `paint` with the place of each pixel that is inside, in a photo of the size `(width, height)` that the picture shows.
    pub fn paint(&self, (width, height): (usize, usize), mut paint: impl FnMut(usize)) {
        let mut inside = Vec::with_capacity(self.size.0 * self.size.1);
        for (i, &count) in self.counts.iter().enumerate() {
            inside.resize(inside.len() + count as usize, i % 2 == 1);
        }
        let columns = shown(self.corner.0, self.size.0, self.picture.0, width);
        for y in shown(self.corner.1, self.size.1, self.picture.1, height) {
            let row = nearest(y, height, self.picture.1) - self.corner.1;
            for x in columns.clone() {
                let column = nearest(x, width, self.picture.0) - self.corner.0;
                let place = if self.by_rows {
                    row * self.size.0 + column
                } else {
                    column * self.size.1 + row
                };
                if inside[place] {
                    paint(y * width + x);
                }
            }
        }
    }
}

/// The pixel of a picture of `whole` pixels across that pixel `x` of a photo of `width` pixels across shows.
fn nearest(x: usize, width: usize, whole: usize) -> usize {
    (x * whole + whole / 2) / width
}

/// The pixels of a photo that show the `length` pixels from `start` on, see [`nearest`].
fn shown(start: usize, length: usize, whole: usize, width: usize) -> Range<usize> {
    let first = |edge: usize| {
        let before = (edge * width).saturating_sub(whole / 2);
        before.div_ceil(whole)
    };
    first(start)..first(start + length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn runs_along_rows_of_a_box_are_painted_where_it_lies() {
        // . # #
        // # . .
        let runs = Runs::of_rows((7, 5), (2, 1), (3, 2), vec![1, 3, 2]).expect("runs");
        assert_eq!(runs.area(), 3);
        let mut painted = Vec::new();
        runs.paint((7, 5), |place| painted.push(place));
        assert_eq!(painted, [7 + 3, 7 + 4, 14 + 2]);
    }

    #[test]
    fn runs_that_do_not_fill_their_box_and_boxes_beyond_the_picture_are_refused() {
        let fits = |corner, size, counts: &[u64]| {
            Runs::of_rows((7, 5), corner, size, counts.to_vec()).is_some()
        };
        assert!(fits((2, 1), (5, 4), &[20]));
        assert!(!fits((3, 1), (5, 4), &[20]));
        assert!(!fits((2, 2), (5, 4), &[20]));
        assert!(!fits((usize::MAX, 1), (5, 4), &[20]));
        assert!(!fits((2, 1), (5, 4), &[19]));
        assert!(!fits((2, 1), (5, 4), &[u64::MAX, 21]));
        assert!(!fits((2, 1), (0, 4), &[]));
        assert!(Runs::of_columns((7, 5), vec![30, 5]).is_some());
        assert!(Runs::of_columns((7, 5), vec![30, 6]).is_none());
    }

    proptest! {
        #[test]
        fn the_pixels_that_show_a_box_are_those_whose_nearest_lies_in_it(
            (whole, start, length) in (1_usize..40).prop_flat_map(|whole| (Just(whole), 0..whole))
                .prop_flat_map(|(whole, start)| (Just(whole), Just(start), 1..=whole - start)),
            width in 1_usize..90,
        ) {
            let direct: Vec<usize> = (0..width)
                .filter(|&x| (start..start + length).contains(&nearest(x, width, whole)))
                .collect();
            prop_assert_eq!(shown(start, length, whole, width).collect::<Vec<_>>(), direct);
        }
    }
}
