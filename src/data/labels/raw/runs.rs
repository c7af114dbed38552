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
    /// Lengths of the runs. Their sum is the number of pixels of the box.
    counts: Vec<u64>,
}

impl Runs {
    /// Runs along the columns of a picture of this size, as COCO has them. `None` where they do not fill it.
    pub fn of_columns(picture: (usize, usize), counts: Vec<u64>) -> Option<Self> {
        let runs = Self::of_rows(picture, (0, 0), picture, counts)?;
        Some(Self {
            by_rows: false,
            ..runs
        })
    }

    /// Runs along the rows of a box, as CVAT has them. `None` where they do not fill it, or where it is not within the picture.
    pub fn of_rows(
        picture: (usize, usize),
        corner: (usize, usize),
        size: (usize, usize),
        counts: Vec<u64>,
    ) -> Option<Self> {
        let runs = Self {
            picture,
            corner,
            size,
            by_rows: true,
            counts,
        };
        runs.fit().then_some(runs)
    }

    /// The runs along the rows of a box that is `inside` pixel by pixel, and `None` as for [`Self::of_rows`].
    pub fn of_pixels(
        picture: (usize, usize),
        corner: (usize, usize),
        size: (usize, usize),
        inside: &[bool],
    ) -> Option<Self> {
        // The first run is one outside, perhaps of no pixel.
        let before = (inside.first() == Some(&true)).then_some(0);
        let lengths = inside.chunk_by(|a, b| a == b).map(|run| run.len() as u64);
        Self::of_rows(
            picture,
            corner,
            size,
            before.into_iter().chain(lengths).collect(),
        )
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

    /// Number of runs.
    pub fn count(&self) -> usize {
        self.counts.len()
    }

    /// Pixels inside.
    pub fn area(&self) -> u64 {
        self.counts.iter().skip(1).step_by(2).sum()
    }

    /// The inside runs, cut at the ends of lines, as the number of the line and the positions along it. A line is a row or a column
    /// of the box.
    fn pieces(&self) -> impl Iterator<Item = (usize, Range<usize>)> {
        let length = if self.by_rows {
            self.size.0
        } else {
            self.size.1
        };
        let mut end = 0;
        let runs = self.counts.iter().enumerate().map(move |(i, &count)| {
            let start = end;
            end += count as usize;
            (i % 2 == 1, start..end)
        });
        let inside = runs.filter(|(is_inside, run)| *is_inside && !run.is_empty());
        inside.flat_map(move |(_, run)| {
            (run.start / length..run.end.div_ceil(length)).map(move |line| {
                let first = line * length;
                let start = run.start.max(first) - first;
                (line, start..run.end.min(first + length) - first)
            })
        })
    }

    /// The smallest ranges of lines, and of positions along them, that hold all inside pixels; `None` where no pixel is inside.
    fn covered(&self) -> Option<(Range<usize>, Range<usize>)> {
        let pieces = self.pieces().map(|(line, piece)| (line..line + 1, piece));
        pieces.reduce(|(lines, along), (line, piece)| {
            let along = along.start.min(piece.start)..along.end.max(piece.end);
            (lines.start..line.end, along)
        })
    }

    /// Scales the picture to a photo of the size `(width, height)`, and calls `paint` with the row-major number of each inside
    /// pixel.
    pub fn paint(&self, (width, height): (usize, usize), mut paint: impl FnMut(usize)) {
        let Some((lines, along)) = self.covered() else {
            return;
        };
        let place = |line: usize, at: usize| (line - lines.start) * along.len() + at - along.start;
        let mut inside = vec![false; lines.len() * along.len()];
        for (line, piece) in self.pieces() {
            inside[place(line, piece.start)..][..piece.len()].fill(true);
        }
        let (across, down) = if self.by_rows {
            (&along, &lines)
        } else {
            (&lines, &along)
        };
        let (left, top) = self.corner;
        let columns = shown(left + across.start, across.len(), self.picture.0, width);
        for y in shown(top + down.start, down.len(), self.picture.1, height) {
            let row = nearest(y, height, self.picture.1) - top;
            for x in columns.clone() {
                let column = nearest(x, width, self.picture.0) - left;
                let place = if self.by_rows {
                    place(row, column)
                } else {
                    place(column, row)
                };
                if inside[place] {
                    paint(y * width + x);
                }
            }
        }
    }
}

/// The pixel of a picture, `whole` pixels wide, at the centre of pixel `x` of the same picture scaled to `width` pixels.
fn nearest(x: usize, width: usize, whole: usize) -> usize {
    (x * whole + whole / 2) / width
}

/// The pixels of a photo, `width` pixels wide, whose [`nearest`] pixel in the picture is one of the `length` from `start` on.
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
    fn only_the_box_of_pixels_inside_is_looked_at() {
        let covered = |counts: &[u64]| {
            let runs = Runs::of_columns((9, 10), counts.to_vec());
            runs.expect("runs").covered()
        };
        // Inside pixels lie in columns 1, 5 and 6, each of ten pixels.
        assert_eq!(covered(&[13, 2, 38, 4, 5, 4, 24]), Some((1..7, 2..7)));
        assert_eq!(covered(&[0, 3, 87]), Some((0..1, 0..3)));
        assert_eq!(covered(&[18, 4, 68]), Some((1..3, 0..10)));
        assert_eq!(covered(&[0, 90]), Some((0..9, 0..10)));
        assert_eq!(covered(&[45, 0, 45]), None);
        let outside = Runs::of_columns((9, 10), vec![90]).expect("runs");
        outside.paint((9, 10), |place| panic!("{place} is painted"));
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
        fn painted_pixels_are_those_whose_nearest_is_inside(
            size in (1_usize..9, 1_usize..9),
            runs in prop::collection::vec(0_u64..12, 0..12),
            corner in (0_usize..4, 0_usize..4),
            rest in (0_usize..4, 0_usize..4),
            photo in (1_usize..30, 1_usize..30),
            by_rows in any::<bool>(),
        ) {
            // Runs along rows are those of a box, runs along columns those of the whole picture. The last run fills the rest.
            let (corner, rest) = if by_rows { (corner, rest) } else { ((0, 0), (0, 0)) };
            let picture = (corner.0 + size.0 + rest.0, corner.1 + size.1 + rest.1);
            let mut left = (size.0 * size.1) as u64;
            let mut counts: Vec<u64> = Vec::new();
            for run in runs {
                counts.push(run.min(left));
                left -= run.min(left);
            }
            counts.push(left);
            let mut inside: Vec<bool> = Vec::new();
            for (i, &count) in counts.iter().enumerate() {
                inside.resize(inside.len() + count as usize, i % 2 == 1);
            }
            let runs = if by_rows {
                Runs::of_rows(picture, corner, size, counts)
            } else {
                Runs::of_columns(picture, counts)
            };
            let is_inside = |place: &usize| {
                let x = nearest(place % photo.0, photo.0, picture.0).checked_sub(corner.0);
                let y = nearest(place / photo.0, photo.1, picture.1).checked_sub(corner.1);
                let (Some(x), Some(y)) = (x, y) else { return false };
                let place = if by_rows { y * size.0 + x } else { x * size.1 + y };
                x < size.0 && y < size.1 && inside[place]
            };
            let expected: Vec<usize> = (0..photo.0 * photo.1).filter(is_inside).collect();
            let mut painted = Vec::new();
            runs.expect("runs").paint(photo, |place| painted.push(place));
            prop_assert_eq!(painted, expected);
        }

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
