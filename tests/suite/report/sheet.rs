//! The contact sheet: photo, raw labels and truth side by side, and segments in colours of their own.

use coseg::data::{Classes, LabelMap, Split, Thumbnail};
use coseg::report::sheet::contact_sheet;
use image::{Rgb, RgbImage};
use std::collections::HashSet;

const PHOTO: Rgb<u8> = Rgb([9, 8, 7]);

/// A view of 40 x 30 pixels whose maps have four equal columns of the ids 1 to 4.
fn tile(are_segments: bool, raw: bool, truth: bool) -> Thumbnail {
    let ids = (0..40 * 30)
        .map(|pixel| (pixel % 40 / 10 + 1) as u16)
        .collect();
    let map = LabelMap {
        width: 40,
        height: 30,
        ids,
    };
    Thumbnail {
        name: "view".into(),
        split: Split::Train,
        photo: RgbImage::from_pixel(40, 30, PHOTO),
        raw: raw.then(|| map.clone()),
        are_segments,
        truth: truth.then_some(map),
    }
}

/// Colours of a row of pixels of the first view's part, counted from the left.
fn colors(sheet: &RgbImage, part: u32) -> HashSet<Rgb<u8>> {
    (0..40)
        .map(|x| *sheet.get_pixel(6 + 40 * part + x, 20))
        .collect()
}

#[test]
fn photo_raw_labels_and_truth_stand_side_by_side() {
    let classes = Classes::from_names(0, [(1, "a"), (2, "b"), (3, "c"), (4, "d")]);
    let both = contact_sheet(&[tile(false, true, true)], &classes);
    assert_eq!(colors(&both, 0), HashSet::from([PHOTO]));
    let expected: HashSet<_> = classes
        .entries
        .iter()
        .map(|class| Rgb(class.color))
        .collect();
    assert_eq!(
        (colors(&both, 1), colors(&both, 2)),
        (expected.clone(), expected.clone())
    );
    let truth = contact_sheet(&[tile(false, false, true)], &classes);
    assert_eq!(colors(&truth, 1), expected);
    assert_eq!(truth.width() + 40, both.width());
}

#[test]
fn each_segment_has_a_colour() {
    // The table of the true labels has nothing to do with the ids of segments.
    let classes = Classes::from_names(0, [(1, "a"), (2, "b")]);
    let sheet = contact_sheet(&[tile(true, true, false)], &classes);
    assert_eq!(colors(&sheet, 1).len(), 4);
}
