//! COCO instances: one JSON file for all photos, with polygons, run lengths, or boxes alone. Larger regions lie below smaller ones.
//!
//! Format: <https://cocodataset.org/#format-data>, 'Object Detection'; CVAT, Label Studio and Roboflow write it.

use super::drawing::{self, Drawing, Point, Region, rectangle};
use super::runs::Runs;
use super::shape_file::drawings;
use super::{RawFile, Vocabulary};
use crate::data::Classes;
use crate::error::{Result, bail, ensure, invalid};
use crate::files::check_pixels;
use serde::Deserialize;
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

const DAMAGED_HELP: &str = "export the instances again";

/// The file. Unknown keys are ignored.
#[derive(Deserialize)]
struct File {
    images: Vec<Image>,
    annotations: Vec<Annotation>,
    categories: Vec<Category>,
}

#[derive(Deserialize)]
struct Image {
    id: u64,
    file_name: String,
    width: Option<usize>,
    height: Option<usize>,
}

#[derive(Deserialize)]
struct Annotation {
    image_id: u64,
    category_id: u64,
    segmentation: Option<Segmentation>,
    /// Left, top, width and height; read if there is no segmentation.
    #[serde(default)]
    bbox: Value,
}

#[derive(Deserialize)]
struct Category {
    id: u64,
    name: String,
}

/// Reads the file at `path` for a scene with the class table `classes`: drawings by the names of those frames that have
/// regions, and a sentence on photos that the scene does not have.
pub(super) fn read(
    path: &Path,
    frames: &[RawFile],
    classes: &Classes,
) -> Result<(HashMap<String, Drawing>, Vocabulary)> {
    let expected = "{\"images\": [{\"id\", \"file_name\", \"width\", \"height\"}, ..], \"annotations\": [{\"image_id\", \
        \"category_id\", \"segmentation\"}, ..], \"categories\": [{\"id\", \"name\"}, ..]}";
    let file: File = drawing::read(path, expected)?;
    let indices = indices(path, &file.categories)?;
    // Ids of categories may begin at 0, which is unlabelled in a class table.
    let names = file.categories.iter().map(|category| &*category.name);
    let mut vocabulary = Vocabulary::new(path, classes, (1..).zip(names))?;
    let mut images = HashMap::new();
    for (i, image) in file.images.iter().enumerate() {
        ensure!(images.insert(image.id, image).is_none(),
            path, "images[{i}].id"; found "{} twice", image.id; expected "each id once"; help "{DAMAGED_HELP}");
    }
    let mut shapes = shapes(path, file.annotations, &images, &indices)?;
    shapes.sort_by(|a, b| b.area.total_cmp(&a.area));
    let mut drawn: BTreeMap<u64, (&str, Drawing)> = BTreeMap::new();
    for shape in shapes {
        let image = shape.image;
        let empty = || Drawing::new(path, image.width.zip(image.height));
        let entry = drawn.entry(image.id);
        let (_, drawing) = entry.or_insert_with(|| (&image.file_name, empty()));
        drawing.add(&vocabulary, Some(shape.category), None, shape.region)?;
    }
    let drawings = drawings(path, frames, drawn.into_values(), &mut vocabulary)?;
    Ok((drawings, vocabulary))
}

/// A region on an image.
struct Shape<'a> {
    image: &'a Image,
    /// Index of its category.
    category: usize,
    area: f64,
    region: Region,
}

/// The regions on the `images`, which have their ids as keys. `indices` has the index of each category by its id.
fn shapes<'a>(
    path: &Path,
    annotations: Vec<Annotation>,
    images: &HashMap<u64, &'a Image>,
    indices: &HashMap<u64, usize>,
) -> Result<Vec<Shape<'a>>> {
    let mut shapes = Vec::new();
    for (i, annotation) in annotations.into_iter().enumerate() {
        let field = |key: &str| format!("annotations[{i}].{key}");
        let category = *indices.get(&annotation.category_id).ok_or_else(|| {
            invalid!(path, "{}", field("category_id"); found "{}", annotation.category_id;
                expected "one of the {} ids of categories", indices.len(); help "{DAMAGED_HELP}")
        })?;
        let image = *images.get(&annotation.image_id).ok_or_else(|| {
            invalid!(path, "{}", field("image_id"); found "{}", annotation.image_id;
                expected "one of the {} ids of images", images.len(); help "{DAMAGED_HELP}")
        })?;
        if let Some(region) = annotation.region(path, field)? {
            shapes.push(Shape {
                image,
                category,
                area: area(&region),
                region,
            });
        }
    }
    Ok(shapes)
}

impl Annotation {
    /// What it covers; `None` where it says nothing. `field` gives the names of its keys for errors.
    fn region(self, path: &Path, field: impl Fn(&str) -> String) -> Result<Option<Region>> {
        if let Some(given) = self.segmentation
            && let Some(region) = given.region(path, &field("segmentation"))?
        {
            return Ok(Some(region));
        }
        box_alone(path, &field("bbox"), &self.bbox)
    }
}

/// The index of each category by its id.
fn indices(path: &Path, categories: &[Category]) -> Result<HashMap<u64, usize>> {
    let mut indices = HashMap::new();
    for (index, category) in categories.iter().enumerate() {
        if index + 1 >= usize::from(u16::MAX) || indices.insert(category.id, index).is_some() {
            bail!(path, "categories[{index}].id"; found "{}", category.id;
                expected "each id once, and at most 65534"; help "{DAMAGED_HELP}");
        }
    }
    ensure!(!indices.is_empty(),
        path, "categories"; found "none"; expected "the classes of the regions"; help "{DAMAGED_HELP}");
    Ok(indices)
}

/// The box of an annotation without a segmentation; `None` where it has no box either. `field` is named in errors.
fn box_alone(path: &Path, field: &str, bbox: &Value) -> Result<Option<Region>> {
    let numbers = Option::<Vec<f64>>::deserialize(bbox);
    match numbers.as_ref().map(Option::as_deref) {
        Ok(None | Some([])) => Ok(None),
        Ok(Some(&[left, top, width, height])) if width >= 0.0 && height >= 0.0 => {
            let corners = rectangle([left, top], [left + width, top + height]);
            Ok(Some(Region::Polygons(vec![corners])))
        }
        _ => {
            bail!(path, "{field}"; found "{bbox}"; expected "left, top, width and height"; help "{DAMAGED_HELP}")
        }
    }
}

/// Pixels that a region covers, where its outlines do not overlap.
fn area(region: &Region) -> f64 {
    match region {
        Region::Runs(runs) => runs.area() as f64,
        Region::Polygons(polygons) => polygons.iter().map(|polygon| area_of(polygon)).sum(),
    }
}

/// The shoelace formula.
fn area_of(polygon: &[Point]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    let edges = polygon.iter().zip(next);
    let twice: f64 = edges.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
    0.5 * twice.abs()
}

/// `segmentation`: a list of polygons `[x, y, x, y, ..]`, or run lengths.
#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected a list of polygons [x, y, x, y, ..] or {\"size\", \"counts\"}"
)]
enum Segmentation {
    Polygons(Vec<Vec<f64>>),
    Runs(RunLengths),
}

#[derive(Deserialize)]
struct RunLengths {
    /// Height and width.
    size: [usize; 2],
    counts: Counts,
}

/// Run lengths, as numbers or packed into a string.
#[derive(Deserialize)]
#[serde(untagged)]
enum Counts {
    Numbers(Vec<u64>),
    Packed(String),
}

impl Segmentation {
    /// What it covers; `None` where it says nothing. `field` is named in errors.
    fn region(self, path: &Path, field: &str) -> Result<Option<Region>> {
        match self {
            Self::Polygons(mut lists) => {
                lists.retain(|list| !list.is_empty());
                let wrong = lists
                    .iter()
                    .find(|list| list.len() < 6 || list.len() % 2 == 1);
                if let Some(list) = wrong {
                    bail!(path, "{field}"; found "a polygon of {} numbers", list.len();
                        expected "x and y of three points or more"; help "{DAMAGED_HELP}");
                }
                let polygon = |list: Vec<f64>| list.as_chunks().0.to_vec();
                let polygons: Vec<Vec<Point>> = lists.into_iter().map(polygon).collect();
                Ok((!polygons.is_empty()).then_some(Region::Polygons(polygons)))
            }
            Self::Runs(RunLengths { size, counts }) => {
                let [height, width] = size;
                check_pixels(path, width, height)?;
                let counts = match counts {
                    Counts::Numbers(counts) => Some(counts),
                    Counts::Packed(text) => unpacked(&text),
                };
                let runs = counts.and_then(|counts| Runs::of_columns((width, height), counts));
                let runs = runs.ok_or_else(|| {
                    invalid!(path, "{field}.counts"; found "run lengths of another number of pixels";
                        expected "{width}x{height} pixels in all"; help "{DAMAGED_HELP}")
                })?;
                Ok(Some(Region::Runs(runs)))
            }
        }
    }
}

/// Run lengths from COCO's string. A number has a sign and 5 bits in each character, the lowest first. From the fourth on, a number
/// is the difference to the run two places before.
fn unpacked(text: &str) -> Option<Vec<u64>> {
    let mut counts: Vec<i64> = Vec::new();
    let mut characters = text.bytes();
    while let Some(mut byte) = characters.next() {
        let mut value = 0_i64;
        let mut shift = 0;
        loop {
            let bits = i64::from(byte.checked_sub(48).filter(|bits| *bits < 64)?);
            value |= (bits & 31) << shift;
            shift += 5;
            if bits & 32 == 0 {
                if bits & 16 != 0 {
                    value |= -1 << shift;
                }
                break;
            }
            // No run is longer than 2^50.
            byte = characters.next().filter(|_| shift < 50)?;
        }
        let before = match counts.len() {
            0..=2 => 0,
            n => counts[n - 2],
        };
        counts.push(value.checked_add(before)?);
    }
    counts
        .into_iter()
        .map(|count| u64::try_from(count).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The inverse of [`unpacked`].
    fn packed(counts: &[u64]) -> String {
        let mut text = String::new();
        for (i, &count) in counts.iter().enumerate() {
            let before = if i > 2 { counts[i - 2] } else { 0 };
            let mut value = count as i64 - before as i64;
            loop {
                let bits = value & 31;
                value >>= 5;
                let is_last = if bits & 16 == 0 {
                    value == 0
                } else {
                    value == -1
                };
                let more = if is_last { 0 } else { 32 };
                text.push(char::from((bits + more + 48) as u8));
                if is_last {
                    break;
                }
            }
        }
        text
    }

    proptest! {
        #[test]
        fn packed_runs_come_back(counts in prop::collection::vec(0_u64..5_000_000, 0..40)) {
            prop_assert_eq!(unpacked(&packed(&counts)), Some(counts));
        }

        #[test]
        fn any_string_is_runs_or_nothing(text in "[ -~]{0,60}") {
            unpacked(&text);
        }
    }

    #[test]
    fn a_string_of_pycocotools_is_understood() {
        // Runs of a picture of 9 x 10 pixels.
        let runs = vec![6, 1, 40, 4, 5, 4, 5, 4, 21];
        assert_eq!(unpacked("61X13mN000`0"), Some(runs));
    }
}
