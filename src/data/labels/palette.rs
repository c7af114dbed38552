//! Colours for class ids: far apart, the same for the same id everywhere.

use glam::{DMat3, DVec3};
use std::sync::LazyLock;

/// Levels of each channel of the candidate colours, 0 to 255.
const LEVELS: usize = 11;
/// Colours before they repeat.
pub(crate) const PALETTE_LENGTH: usize = 255;
/// Colours that stand for something else, and how far off all others stay in OKLab: black (void, and behind a scene), white
/// (paper), grey (behind a scene), and what is unlabelled in pictures.
const RESERVED: [([u8; 3], f64); 4] = [
    ([0; 3], 0.3),
    ([255; 3], 0.12),
    ([128; 3], 0.1),
    (UNLABELLED_COLOR, 0.12),
];
/// The colour of unlabelled pixels in pictures.
pub const UNLABELLED_COLOR: [u8; 3] = [38, 38, 42];

/// The colour of a class id, 8-bit sRGB; ids 255 apart share one. None looks like black, white, grey, or unlabelled pixels.
pub fn class_color(id: u16) -> [u8; 3] {
    static PALETTE: LazyLock<Vec<[u8; 3]>> = LazyLock::new(palette);
    PALETTE[usize::from(id) % PALETTE.len()]
}

/// Farthest-point order of a grid of sRGB colours in OKLab without those near reserved ones. Each colour is farthest from black,
/// white and all colours before it. Ties go to the first in grid order.
fn palette() -> Vec<[u8; 3]> {
    let candidates = (0..LEVELS.pow(3))
        .map(|i| [i / (LEVELS * LEVELS), i / LEVELS % LEVELS, i % LEVELS])
        .map(|levels| levels.map(|l| (l * 255 / (LEVELS - 1)) as u8))
        .map(|rgb| (rgb, oklab(rgb)));
    let reserved = RESERVED.map(|(rgb, apart)| (oklab(rgb), apart));
    let candidates: Vec<([u8; 3], DVec3)> = candidates
        .filter(|(_, lab)| {
            reserved
                .iter()
                .all(|(other, apart)| lab.distance(*other) >= *apart)
        })
        .collect();
    let [(black, _), (white, _), ..] = reserved;
    let mut nearest: Vec<f64> = candidates
        .iter()
        .map(|(_, lab)| lab.distance(black).min(lab.distance(white)))
        .collect();
    let mut colors = Vec::with_capacity(PALETTE_LENGTH);
    for _ in 0..PALETTE_LENGTH {
        let best = (1..nearest.len()).fold(
            0,
            |best, i| if nearest[i] > nearest[best] { i } else { best },
        );
        let (rgb, chosen) = candidates[best];
        colors.push(rgb);
        for (near, (_, lab)) in nearest.iter_mut().zip(&candidates) {
            *near = near.min(lab.distance(chosen));
        }
    }
    colors
}

/// How different two sRGB colours look: their distance in OKLab.
pub(crate) fn difference(a: [u8; 3], b: [u8; 3]) -> f64 {
    oklab(a).distance(oklab(b))
}

/// An sRGB value in 0..1 in linear light.
pub(crate) fn linear(s: f64) -> f64 {
    if s <= 0.040_45 {
        s / 12.92
    } else {
        ((s + 0.055) / 1.055).powf(2.4)
    }
}

/// sRGB to OKLab (B. Ottosson, "A perceptual color space for image processing", 2020).
fn oklab(rgb: [u8; 3]) -> DVec3 {
    let from_rows = |rows| DMat3::from_cols_array_2d(rows).transpose();
    let to_cones = from_rows(&[
        [0.412_221_470_8, 0.536_332_536_3, 0.051_445_992_9],
        [0.211_903_498_2, 0.680_699_545_1, 0.107_396_956_6],
        [0.088_302_461_9, 0.281_718_837_6, 0.629_978_700_5],
    ]);
    let from_cones = from_rows(&[
        [0.210_454_255_3, 0.793_617_785_0, -0.004_072_046_8],
        [1.977_998_495_1, -2.428_592_205_0, 0.450_593_709_9],
        [0.025_904_037_1, 0.782_771_766_2, -0.808_675_766_0],
    ]);
    let cones = to_cones * DVec3::from(rgb.map(|v| linear(f64::from(v) / 255.0)));
    from_cones * DVec3::from(cones.to_array().map(f64::cbrt))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_far_apart() {
        // White is (1, 0, 0) in OKLab; a step of 0.02 is just visible.
        assert!(oklab([255; 3]).distance(DVec3::X) < 1e-6);
        for (ids, apart) in [(10, 0.2), (40, 0.11), (254, 0.03)] {
            let mut labs: Vec<_> = (0..=ids).map(|id| oklab(class_color(id))).collect();
            labs.extend([oklab([0; 3]), oklab([255; 3])]);
            for (i, a) in labs.iter().enumerate() {
                assert!(
                    labs[..i].iter().all(|b| a.distance(*b) > apart),
                    "{i} of {ids}"
                );
            }
        }
        assert_eq!(class_color(7), class_color(7 + 255));
    }

    #[test]
    fn no_colour_stands_for_something_else() {
        for id in 0..=254 {
            for (reserved, apart) in RESERVED {
                let found = difference(class_color(id), reserved);
                assert!(found >= apart, "{id}: {found} from {reserved:?}");
            }
        }
    }
}
