//! Pictures: coloured label maps with legends, error maps, floats as 8-bit images.

use crate::data::{Classes, LabelMap, class_color};
use crate::error::{Error, Result, invalid};
use crate::files::atomic;
use font8x8::legacy::BASIC_LEGACY;
use image::{Rgb, RgbImage};
use std::io::Cursor;
use std::path::Path;

/// Pixels across a character, and from its top to its bottom.
pub(super) const GLYPH: usize = 8;
pub use crate::data::labels::palette::UNLABELLED_COLOR;
/// Colour of ids that are not in the class table.
const UNKNOWN: [u8; 3] = [255, 0, 200];
/// Colours of [`label_error`]: right, wrong, truth unlabelled.
pub const AGREEMENT: [[u8; 3]; 3] = [[226, 229, 226], [208, 52, 44], [112, 114, 120]];
/// Mean absolute RGB error at which [`rgb_error`] reaches its brightest colour.
pub const ERROR_FULL: f32 = 0.1;

/// `[H, W, 3]` floats as 8-bit sRGB: clamped to 0..1 and rounded. NaN becomes 0.
///
/// # Errors
/// [`Error::Limit`] when `rgb` does not have `width * height * 3` values.
pub fn from_floats(rgb: &[f32], width: usize, height: usize) -> Result<RgbImage> {
    let byte = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let bytes = rgb.iter().map(byte).collect();
    RgbImage::from_raw(width as u32, height as u32, bytes).ok_or_else(|| {
        invalid!(limit "image values"; found "{}", rgb.len(); expected "{width} x {height} x 3";
            help "pass an [H, W, 3] image")
    })
}

/// A label map in class colours.
pub fn colored(labels: &LabelMap, classes: &Classes) -> RgbImage {
    let color = |id: u16| match classes.index(id) {
        Some(i) => classes.entries[i].color,
        None if id == classes.ignore => UNLABELLED_COLOR,
        None => UNKNOWN,
    };
    per_pixel(labels.width, labels.height, |p| color(labels.ids[p]))
}

/// A map of segments in a colour for each, whatever the classes.
pub fn colored_segments(segments: &LabelMap) -> RgbImage {
    let color = |id: u16| {
        if id == 0 {
            UNLABELLED_COLOR
        } else {
            class_color(id)
        }
    };
    per_pixel(segments.width, segments.height, |p| color(segments.ids[p]))
}

/// Light where the labels equal the truth, red where they differ, grey where the truth has no label.
pub fn label_error(labels: &LabelMap, truth: &LabelMap, ignore: u16) -> RgbImage {
    per_pixel(truth.width, truth.height, |p| {
        match (truth.ids[p], labels.ids.get(p)) {
            (t, _) if t == ignore => AGREEMENT[2],
            (t, Some(&id)) if t == id => AGREEMENT[0],
            _ => AGREEMENT[1],
        }
    })
}

/// Share of labelled pixels with the right label; `None` when the truth has no labelled pixel.
pub fn accuracy(labels: &LabelMap, truth: &LabelMap, ignore: u16) -> Option<f64> {
    let pairs = || labels.ids.iter().zip(&truth.ids);
    let all = pairs().filter(|(_, t)| **t != ignore).count();
    let right = pairs().filter(|(id, t)| id == t && **t != ignore).count();
    (all > 0).then(|| right as f64 / all as f64)
}

/// Mean absolute RGB error of each pixel as a heat map: black is 0, bright yellow [`ERROR_FULL`] or more.
pub fn rgb_error(a: &RgbImage, b: &RgbImage) -> RgbImage {
    let (width, height) = (a.width().min(b.width()), a.height().min(b.height()));
    RgbImage::from_fn(width, height, |x, y| {
        let (p, q) = (a.get_pixel(x, y).0, b.get_pixel(x, y).0);
        let pairs = p.iter().zip(q);
        let sum: u32 = pairs.map(|(&p, q)| u32::from(p.abs_diff(q))).sum();
        Rgb(heat(sum as f32 / (3.0 * 255.0) / ERROR_FULL))
    })
}

/// A colour for a share in 0..1: black, violet, red, orange, pale yellow, in even steps of lightness.
pub fn heat(share: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [0.0, 0.0, 4.0],
        [87.0, 16.0, 110.0],
        [188.0, 55.0, 84.0],
        [249.0, 142.0, 9.0],
        [252.0, 255.0, 164.0],
    ];
    let at = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (at as usize).min(STOPS.len() - 2);
    let f = at - i as f32;
    std::array::from_fn(|c| (STOPS[i][c] + f * (STOPS[i + 1][c] - STOPS[i][c])).round() as u8)
}

/// Shares in 0..1 as [`heat`] over the colours `rgb` `[H, W, 3]`, 0..1, which are grey and dark where the share is low.
///
/// # Errors
/// As [`from_floats`].
pub fn heated(rgb: &[f32], shares: &[f32], width: usize, height: usize) -> Result<RgbImage> {
    let mut picture = from_floats(rgb, width, height)?;
    for (pixel, share) in picture.pixels_mut().zip(shares) {
        let share = share.clamp(0.0, 1.0);
        let grey = pixel.0.iter().map(|&v| f32::from(v)).sum::<f32>() / 6.0;
        pixel.0 = heat(share).map(|v| (share * f32::from(v) + (1.0 - share) * grey).round() as u8);
    }
    Ok(picture)
}

fn per_pixel(width: usize, height: usize, color: impl Fn(usize) -> [u8; 3]) -> RgbImage {
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        Rgb(color(y as usize * width + x as usize))
    })
}

/// `picture` with a strip below. The strip names each class in `labels`: swatch, id, name.
pub fn with_legend(picture: &RgbImage, labels: &LabelMap, classes: &Classes) -> RgbImage {
    let mut present = vec![false; 1 << 16];
    for &id in &labels.ids {
        present[id as usize] = true;
    }
    let listed = classes.entries.iter().filter(|c| present[c.id as usize]);
    let mut entries: Vec<([u8; 3], String)> = listed
        .map(|c| (c.color, format!("{} {}", c.id, c.name)))
        .collect();
    if present[classes.ignore as usize] {
        entries.push((UNLABELLED_COLOR, "unlabelled".into()));
    }
    let scale = if picture.width() >= 900 { 2 } else { 1 };
    let swatch = 9 * scale;
    let gap = 4 * scale;
    let line = 15 * scale;
    let cell = |text: &str| swatch + gap + GLYPH * scale * text.chars().count() + 3 * gap;
    let widest = entries.iter().map(|(_, text)| cell(text)).max();
    let widest = widest.unwrap_or(0);
    let columns = (picture.width() as usize / widest.max(1)).max(1);
    let rows = entries.len().div_ceil(columns);
    let strip = if rows == 0 { 0 } else { rows * line + 2 * gap };
    let height = picture.height() + strip as u32;
    let mut out = RgbImage::from_pixel(picture.width(), height, Rgb([250, 250, 248]));
    image::imageops::replace(&mut out, picture, 0, 0);
    for (i, (color, text)) in entries.iter().enumerate() {
        let x = gap + (i % columns) * (picture.width() as usize / columns);
        let y = picture.height() as usize + gap + (i / columns) * line;
        fill(&mut out, (x, y), swatch, *color);
        draw_text(&mut out, (x + swatch + gap, y + scale), scale, text);
    }
    out
}

/// Fills a square, as far as it lies in the image.
fn fill(image: &mut RgbImage, (x, y): (usize, usize), side: usize, color: [u8; 3]) {
    for row in y..(y + side).min(image.height() as usize) {
        for column in x..(x + side).min(image.width() as usize) {
            image.put_pixel(column as u32, row as u32, Rgb(color));
        }
    }
}

pub(super) fn draw_text(image: &mut RgbImage, (x, y): (usize, usize), scale: usize, text: &str) {
    for (i, c) in text.chars().enumerate() {
        // Characters beyond ASCII are drawn as question marks.
        let glyph = BASIC_LEGACY
            .get(c as usize)
            .unwrap_or(&BASIC_LEGACY['?' as usize]);
        for (row, bits) in glyph.iter().enumerate() {
            for column in (0..GLYPH).filter(|column| bits >> column & 1 == 1) {
                let at = (x + scale * (GLYPH * i + column), y + scale * row);
                fill(image, at, scale, [28, 28, 30]);
            }
        }
    }
}

/// Writes an RGB image as PNG, atomically.
///
/// # Errors
/// [`Error::Io`] naming `path`.
pub fn write(path: &Path, image: &RgbImage) -> Result<()> {
    atomic::write_bytes(path, &png(image, path)?)
}

/// An RGB image as PNG bytes.
///
/// # Errors
/// [`Error::Io`] naming `path`, the file of the bytes, when encoding fails.
pub fn png(image: &RgbImage, path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, image::ImageFormat::Png)
        .map_err(|e| Error::io(path, "encode", std::io::Error::other(e)))?;
    Ok(bytes.into_inner())
}
