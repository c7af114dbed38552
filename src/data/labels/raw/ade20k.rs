//! PNG in the colours of ADE20K, RGB or indexed, as demonstrations of mmsegmentation and Mask2Former draw them. Class ids
//! are ADE20K's own, 1 to 150; black is unlabelled.

use super::{RawMap, Unmatched, Vocabulary};
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Segment};
use crate::error::{Result, bail};
use std::collections::HashMap;
use std::path::Path;
use std::sync::LazyLock;

/// The 150 classes of the ADE20K scene parsing benchmark in its order, with the colours in which mmsegmentation
/// (`mmseg/datasets/ade.py`) and Mask2Former (`register_ade20k_panoptic.py`) draw them; the two agree.
const TABLE: &str = include_str!("../tables/ade20k.tsv");

const BLACK: [u8; 3] = [0; 3];

/// Class index of each colour. Two classes have one colour; the first counts.
static COLORS: LazyLock<HashMap<[u8; 3], usize>> = LazyLock::new(|| {
    let mut colors = HashMap::new();
    for (i, (_, text)) in rows().enumerate() {
        let mut channels = text.split(' ').map(|channel| channel.parse().unwrap_or(0));
        let color = [0; 3].map(|_: u8| channels.next().unwrap_or(0));
        colors.entry(color).or_insert(i);
    }
    colors
});

/// Name and colour of each class.
fn rows() -> impl Iterator<Item = (&'static str, &'static str)> {
    TABLE.lines().filter_map(|row| row.split_once('\t'))
}

/// Whether a map has colours of this palette and no others.
pub(super) fn matches(file: &ImageFile) -> bool {
    let known = |color: [u8; 3]| color == BLACK || COLORS.contains_key(&color);
    file.decode_rgb()
        .is_ok_and(|image| image.pixels().all(|pixel| known(pixel.0)))
}

/// The vocabulary for a scene with the class table `classes`; `file` is named in errors.
pub(super) fn vocabulary(file: &Path, classes: &Classes) -> Result<Vocabulary> {
    Vocabulary::new(file, classes, (1..).zip(rows().map(|(name, _)| name)))
}

/// The map in class ids of the scene, which are `class_ids` by class index. All its segments are stuff: it tells no things apart.
/// Its pixels are counted in `unmatched`.
pub(super) fn decode(
    path: &Path,
    file: &ImageFile,
    class_ids: &[Option<u16>],
    ignore: u16,
    unmatched: Option<&Unmatched>,
) -> Result<RawMap> {
    if !matches!(file.png_color(), Some((_, 2 | 3 | 6))) {
        let found = file.png_color().map_or("JPEG", |_| "a grey PNG");
        bail!(path, "pixel format"; found "{found}";
            expected "a PNG with the colours of ADE20K, RGB or indexed";
            help "set data.raw_format = \"grey\" for class ids; JPEG changes colours, so save as PNG");
    }
    let (width, height) = file.size;
    let mut ids = Vec::with_capacity(width * height);
    let mut pixels = vec![0; class_ids.len()];
    for (i, pixel) in file.decode_rgb()?.pixels().enumerate() {
        let class = COLORS.get(&pixel.0);
        if class.is_none() && pixel.0 != BLACK {
            bail!(path, "pixel x {}, y {}", i % width, i / width; found "colour {:?}", pixel.0;
                expected "one of the 150 colours of ADE20K, or black for unlabelled";
                help "save the map without blending it over the photo, and as PNG");
        }
        if let Some(&class) = class {
            pixels[class] += 1;
        }
        ids.push(class.and_then(|&class| class_ids[class]).unwrap_or(ignore));
    }
    if let Some(unmatched) = unmatched {
        unmatched.count(&pixels, ids.len());
    }
    let map = LabelMap { width, height, ids };
    let stuff = |&id| Segment {
        id,
        class: Some(id),
        thing: false,
    };
    let segments = class_ids.iter().flatten().map(stuff).collect();
    Ok(RawMap { map, segments })
}
