//! PNG in the colours of ADE20K, RGB or indexed, as demonstrations of mmsegmentation and Mask2Former draw them. Class ids
//! are ADE20K's own, 1 to 150; black is unlabelled.

use super::Vocabulary;
use super::ade20k_table::ADE20K;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Segment};
use crate::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;

const BLACK: [u8; 3] = [0; 3];

/// Class index of each colour; of the one colour of two classes, the first.
fn table() -> HashMap<[u8; 3], usize> {
    ADE20K
        .iter()
        .enumerate()
        .rev()
        .map(|(i, (_, color))| (*color, i))
        .collect()
}

/// Whether a map has colours of this palette and no others.
pub(crate) fn matches(file: &ImageFile) -> bool {
    let table = table();
    let known = |color: [u8; 3]| color == BLACK || table.contains_key(&color);
    file.decode_rgb()
        .is_ok_and(|image| image.pixels().all(|pixel| known(pixel.0)))
}

/// From colours to class ids of the scene.
pub(crate) struct Palette {
    table: HashMap<[u8; 3], usize>,
    vocabulary: Vocabulary,
}

impl Palette {
    /// For a scene with the class table `classes`; `file` is named in errors.
    pub fn new(file: &Path, classes: &Classes) -> Result<Self> {
        let names: Vec<(u16, &str)> = (1..).zip(ADE20K.iter().map(|(name, _)| *name)).collect();
        Ok(Self {
            table: table(),
            vocabulary: Vocabulary::new(file, classes, &names)?,
        })
    }

    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// All classes as stuff: the maps tell no things apart.
    pub fn stuff(&self) -> Vec<Segment> {
        let ids = self.vocabulary.ids.iter().flatten();
        ids.map(|&id| Segment {
            id,
            class: Some(id),
            thing: false,
        })
        .collect()
    }

    /// The map in class ids of the scene.
    pub fn decode(&self, path: &Path, file: &ImageFile) -> Result<LabelMap> {
        if !matches!(file.png_color(), Some((_, 2 | 3 | 6))) {
            let found = if file.png_color().is_some() {
                "a grey PNG"
            } else {
                "JPEG"
            };
            let expected = "a PNG with the colours of ADE20K, RGB or indexed";
            let help = "set data.raw_format = \"grey\" for class ids; JPEG changes colours, so save as PNG";
            return Err(Error::input(path, "pixel format", found, expected, help));
        }
        let image = file.decode_rgb()?;
        let (width, height) = file.size;
        let ignore = self.vocabulary.classes.ignore;
        let mut ids = Vec::with_capacity(width * height);
        for (i, pixel) in image.pixels().enumerate() {
            let class = self.table.get(&pixel.0);
            if class.is_none() && pixel.0 != BLACK {
                let field = format!("pixel x {}, y {}", i % width, i / width);
                let expected = "one of the 150 colours of ADE20K, or black for unlabelled";
                let help = "save the map without blending it over the photo, and as PNG";
                return Err(Error::input(
                    path,
                    field,
                    format!("colour {:?}", pixel.0),
                    expected,
                    help,
                ));
            }
            ids.push(
                class
                    .and_then(|&class| self.vocabulary.ids[class])
                    .unwrap_or(ignore),
            );
        }
        Ok(LabelMap { width, height, ids })
    }
}
