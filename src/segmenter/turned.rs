//! Photos that are stored on their side or mirrored. A network sees them upright, as their EXIF orientation says. Labels are of the
//! pixels as they are stored, as poses are.

use super::run::Logits;
use image::metadata::Orientation;
use image::{DynamicImage, RgbImage};

/// The photo as its EXIF orientation says that it should be shown.
pub(super) fn upright(photo: RgbImage, orientation: Orientation) -> RgbImage {
    let mut photo = DynamicImage::from(photo);
    photo.apply_orientation(orientation);
    photo.into_rgb8()
}

/// Whether the upright photo becomes the stored one by mirroring it across and down, and by then swapping its axes.
const fn back(orientation: Orientation) -> ([bool; 2], bool) {
    match orientation {
        Orientation::NoTransforms => ([false, false], false),
        Orientation::FlipHorizontal => ([true, false], false),
        Orientation::FlipVertical => ([false, true], false),
        Orientation::Rotate180 => ([true, true], false),
        Orientation::Rotate90FlipH => ([false, false], true),
        Orientation::Rotate90 => ([true, false], true),
        Orientation::Rotate270 => ([false, true], true),
        Orientation::Rotate270FlipH => ([true, true], true),
    }
}

impl Logits {
    /// What these say, for the upright photo, about the photo as it is stored.
    pub(super) fn turned_back(mut self, orientation: Orientation) -> Self {
        let (mirrored, swapped) = back(orientation);
        let cells = [self.width, self.height];
        let grid = &mut self.grid;
        for a in 0..2 {
            if mirrored[a] {
                let end = grid.offset[a] + grid.scale[a] * grid.photo[a] as f64;
                grid.offset[a] = (cells[a] - 1) as f64 - end;
            }
        }
        if swapped {
            grid.photo.swap(0, 1);
            grid.scale.swap(0, 1);
            grid.offset.swap(0, 1);
            std::mem::swap(&mut self.width, &mut self.height);
        }
        let classes = self.values.len() / (cells[0] * cells[1]).max(1);
        let mut values = Vec::with_capacity(self.values.len());
        for row in 0..self.height {
            for column in 0..self.width {
                let mut at = if swapped {
                    [row, column]
                } else {
                    [column, row]
                };
                for a in 0..2 {
                    if mirrored[a] {
                        at[a] = cells[a] - 1 - at[a];
                    }
                }
                let first = (at[1] * cells[0] + at[0]) * classes;
                values.extend_from_slice(&self.values[first..][..classes]);
            }
        }
        self.values = values;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::ScoreGrid;
    use crate::segmenter::contract::Values;
    use image::Rgb;

    /// Columns and rows of the stored photo.
    const SIZE: [u32; 2] = [6, 4];

    #[test]
    fn every_orientation_comes_back() {
        let stored = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| Rgb([x as u8, y as u8, 0]));
        for exif in 1..=8 {
            let orientation = Orientation::from_exif(exif).expect("an orientation");
            let upright = upright(stored.clone(), orientation);
            // A cell for each pixel and one more on every side, which says the pixel's place in the stored photo.
            let (width, height) = (upright.width() as usize + 2, upright.height() as usize + 2);
            let place = |i: usize| {
                let inside = |v: usize, n: u32| (v.max(1) as u32 - 1).min(n - 1);
                let pixel = upright.get_pixel(
                    inside(i % width, upright.width()),
                    inside(i / width, upright.height()),
                );
                [f32::from(pixel.0[0]), f32::from(pixel.0[1])]
            };
            let logits = Logits {
                grid: ScoreGrid {
                    photo: [width - 2, height - 2],
                    scale: [1.0; 2],
                    offset: [0.5; 2],
                },
                width,
                height,
                values: (0..width * height).flat_map(place).collect(),
                kind: Values::Logits,
            };
            let found = logits.turned_back(orientation);
            assert_eq!(found.grid.photo, SIZE.map(|side| side as usize), "{exif}");
            for (x, y, _) in stored.enumerate_pixels() {
                let cell = |a: usize, v: u32| {
                    found.grid.scale[a] * (f64::from(v) + 0.5) + found.grid.offset[a]
                };
                let [column, row] = [cell(0, x), cell(1, y)];
                assert_eq!([column, row], [f64::from(x) + 1.0, f64::from(y) + 1.0]);
                let first = 2 * (row as usize * found.width + column as usize);
                assert_eq!(found.values[first..][..2], [x as f32, y as f32], "{exif}");
            }
        }
    }

    #[test]
    fn cells_that_do_not_end_with_the_photo_stay_where_they_are() {
        let logits = Logits {
            grid: ScoreGrid {
                photo: [10, 6],
                scale: [0.25, 0.5],
                offset: [-0.5, -0.2],
            },
            width: 4,
            height: 3,
            values: vec![0.0; 12],
            kind: Values::Logits,
        };
        // The pixel in the left upper corner of the upright photo is in the left lower corner of one that is stored a quarter turn
        // to the left.
        let cells = [0.25 * 0.5 - 0.5, 0.5 * 0.5 - 0.2];
        let stored = logits.turned_back(Orientation::Rotate90).grid;
        let [column, row] =
            [(0, 0.5), (1, 9.5)].map(|(a, pixel)| stored.scale[a] * pixel + stored.offset[a]);
        assert!((column - cells[1]).abs() < 1e-12, "{column}");
        assert!((row - (3.0 - cells[0])).abs() < 1e-12, "{row}");
    }
}
