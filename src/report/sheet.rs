//! A contact sheet: small photos with their raw and true labels side by side, in one picture.

use super::pictures::{GLYPH, colored, colored_segments, draw_text, with_legend};
use crate::data::{Classes, LabelMap, Split, Thumbnail};
use image::imageops::replace;
use image::{Rgb, RgbImage};

/// Pictures in a row, about.
const COLUMNS: usize = 5;
/// Pixels between views.
const GAP: usize = 6;
/// Height of the line with the captions, pixels.
const CAPTION: usize = GLYPH + 5;

/// Views in rows: each its photo, then its raw and its true labels where some view has them, with captions. A legend of the
/// classes at the end. Where raw labels are segments, each has a colour of its own.
pub fn contact_sheet(tiles: &[Thumbnail], classes: &Classes) -> RgbImage {
    let longest = |side: fn(&RgbImage) -> u32| {
        let sides = tiles.iter().map(|tile| side(&tile.photo) as usize);
        sides.max().unwrap_or(1)
    };
    let (width, height) = (longest(RgbImage::width), longest(RgbImage::height));
    let has =
        |map: fn(&Thumbnail) -> &Option<LabelMap>| tiles.iter().any(|tile| map(tile).is_some());
    let (has_raw, has_truth) = (has(|tile| &tile.raw), has(|tile| &tile.truth));
    let parts = 1 + usize::from(has_raw) + usize::from(has_truth);
    let cell = [width * parts + GAP, height + CAPTION + GAP];
    let columns = COLUMNS.div_ceil(parts).min(tiles.len()).max(1);
    let rows = tiles.len().div_ceil(columns);
    let size = [columns * cell[0] + GAP, rows * cell[1] + GAP].map(|v| v as u32);
    let mut sheet = RgbImage::from_pixel(size[0], size[1], Rgb([250, 250, 248]));
    for (i, tile) in tiles.iter().enumerate() {
        let name = match tile.split {
            Split::Train => tile.name.clone(),
            Split::Test => format!("test {}", tile.name),
        };
        let raw = tile.raw.as_ref().map(|raw| {
            if tile.are_segments {
                ("segments", colored_segments(raw))
            } else {
                ("raw labels", colored(raw, classes))
            }
        });
        let truth = tile.truth.as_ref();
        let truth = truth.map(|truth| ("true labels", colored(truth, classes)));
        let photo = Some((&*name, tile.photo.clone()));
        let parts = [(true, photo), (has_raw, raw), (has_truth, truth)];
        let shown = parts.into_iter().filter(|(shown, _)| *shown);
        let y = GAP + i / columns * cell[1];
        for (part, (_, picture)) in shown.enumerate() {
            let x = GAP + i % columns * cell[0] + part * width;
            if let Some((caption, picture)) = picture {
                replace(&mut sheet, &picture, x as i64, y as i64);
                let caption: String = caption.chars().take(width / GLYPH).collect();
                draw_text(&mut sheet, (x, y + height + 3), 1, &caption);
            }
        }
    }
    with_legend(&sheet, &shown(tiles), classes)
}

/// The ids of classes that the sheet shows, as a map without pixels.
fn shown(tiles: &[Thumbnail]) -> LabelMap {
    let of_classes = tiles.iter().filter(|tile| !tile.are_segments);
    let raw = of_classes.filter_map(|tile| tile.raw.as_ref());
    let truth = tiles.iter().filter_map(|tile| tile.truth.as_ref());
    let ids = raw.chain(truth).flat_map(|map| &map.ids).copied().collect();
    LabelMap {
        width: 0,
        height: 0,
        ids,
    }
}
