//! A contact sheet: small photos with their labels, names and splits in one picture.

use super::pictures::{GLYPH, colored, draw_text, with_legend};
use crate::data::{Classes, LabelMap, Split, Thumbnail};
use image::imageops::replace;
use image::{Rgb, RgbImage};

/// Photos in a row.
const COLUMNS: usize = 5;
/// Pixels between them.
const GAP: usize = 6;
/// Height of the line with the name, pixels.
const CAPTION: usize = GLYPH + 5;

/// Photos in rows of five; where some have label maps, these are below them, with a legend at the end.
pub fn contact_sheet(tiles: &[Thumbnail], classes: &Classes) -> RgbImage {
    let width = tiles
        .iter()
        .map(|tile| tile.photo.width() as usize)
        .max()
        .unwrap_or(1);
    let height = tiles
        .iter()
        .map(|tile| tile.photo.height() as usize)
        .max()
        .unwrap_or(1);
    let labelled = tiles.iter().any(|tile| tile.labels.is_some());
    let cell = [
        width + GAP,
        height * (1 + usize::from(labelled)) + CAPTION + GAP,
    ];
    let columns = COLUMNS.min(tiles.len()).max(1);
    let rows = tiles.len().div_ceil(columns);
    let size = [columns * cell[0] + GAP, rows * cell[1] + GAP].map(|v| v as u32);
    let mut sheet = RgbImage::from_pixel(size[0], size[1], Rgb([250, 250, 248]));
    for (i, tile) in tiles.iter().enumerate() {
        let at = [GAP + i % columns * cell[0], GAP + i / columns * cell[1]];
        let [x, y] = at.map(|v| v as i64);
        replace(&mut sheet, &tile.photo, x, y);
        if let Some(labels) = &tile.labels {
            replace(&mut sheet, &colored(labels, classes), x, y + height as i64);
        }
        let split = if tile.split == Split::Test {
            "test "
        } else {
            ""
        };
        let room = width / GLYPH;
        let caption: String = format!("{split}{}", tile.name).chars().take(room).collect();
        draw_text(
            &mut sheet,
            (at[0], at[1] + cell[1] - CAPTION - GAP + 3),
            1,
            &caption,
        );
    }
    if !labelled {
        return sheet;
    }
    let ids = tiles
        .iter()
        .filter_map(|tile| tile.labels.as_ref())
        .flat_map(|map| &map.ids)
        .copied()
        .collect();
    with_legend(
        &sheet,
        &LabelMap {
            width: 0,
            height: 0,
            ids,
        },
        classes,
    )
}
