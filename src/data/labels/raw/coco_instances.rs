//! COCO instances: one JSON file for all photos, with polygons or run lengths. Larger regions lie below smaller ones.
//!
//! Format: <https://cocodataset.org/#format-data>, 'Object Detection'; CVAT, Label Studio and Roboflow write it.

use super::drawing::{self, Drawing, Point, Region};
use super::{RawFile, Vocabulary};
use crate::data::{Classes, Limits, LoadOptions, MapGeometry};
use crate::error::{Result, bail, ensure, invalid};
use crate::files::names;
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// JSON files in a folder of labels that are something else.
const OTHER_FILES: [&str; 3] = ["classes.json", "label.json", MapGeometry::FILE];
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
    #[serde(default)]
    segmentation: Segmentation,
}

#[derive(Deserialize)]
struct Category {
    id: u64,
    name: String,
}

/// The file that `data.raw_labels` names; in a folder, the only JSON file that is not one of [`OTHER_FILES`].
pub(crate) fn find(dir: &Path, options: &LoadOptions) -> Option<PathBuf> {
    let named = dir.join(options.raw_labels.as_deref()?);
    if named.is_file() {
        return Some(named);
    }
    let files = names(&named, |name, path| {
        name.ends_with(".json") && !OTHER_FILES.contains(&name) && path.is_file()
    });
    match &files[..] {
        [only] => Some(named.join(only)),
        _ => None,
    }
}

/// Reads the file at `path` for a scene with the class table `classes`: drawings by the names of those frames that have
/// regions, and a sentence on photos that the scene does not have.
pub(super) fn read(
    path: &Path,
    frames: &[RawFile],
    classes: &Classes,
    limits: &Limits,
) -> Result<(HashMap<String, Drawing>, Vocabulary)> {
    let expected = "{\"images\": [{\"id\", \"file_name\", \"width\", \"height\"}, ..], \"annotations\": [{\"image_id\", \
        \"category_id\", \"segmentation\"}, ..], \"categories\": [{\"id\", \"name\"}, ..]}";
    let file: File = drawing::read(path, expected)?;
    // Ids of categories may begin at 0, which is unlabelled in a class table.
    let names: Vec<(u16, &str)> = (1..)
        .zip(&file.categories)
        .map(|(id, category)| (id, category.name.as_str()))
        .collect();
    let mut indices = HashMap::new();
    for (index, category) in file.categories.iter().enumerate() {
        if index >= usize::from(u16::MAX) || indices.insert(category.id, index).is_some() {
            bail!(path, "categories[{index}].id"; found "{}", category.id;
                expected "each id once, and at most 65534"; help "{DAMAGED_HELP}");
        }
    }
    ensure!(!names.is_empty(),
        path, "categories"; found "none"; expected "the classes of the regions"; help "{DAMAGED_HELP}");
    let mut vocabulary = Vocabulary::new(path, classes, &names)?;
    let mut images = HashMap::new();
    for (i, image) in file.images.iter().enumerate() {
        ensure!(images.insert(image.id, image).is_none(),
            path, "images[{i}].id"; found "{} twice", image.id; expected "each id once"; help "{DAMAGED_HELP}");
    }
    let mut of_images: BTreeMap<u64, Vec<(f64, usize, Region)>> = BTreeMap::new();
    for (i, annotation) in file.annotations.into_iter().enumerate() {
        let field = |key: &str| format!("annotations[{i}].{key}");
        let index = indices.get(&annotation.category_id).copied();
        let index = index.ok_or_else(|| {
            invalid!(path, "{}", field("category_id"); found "{}", annotation.category_id;
                expected "one of the {} ids of categories", names.len(); help "{DAMAGED_HELP}")
        })?;
        ensure!(images.contains_key(&annotation.image_id),
            path, "{}", field("image_id"); found "{}", annotation.image_id;
            expected "one of the {} ids of images", images.len(); help "{DAMAGED_HELP}");
        let region = annotation
            .segmentation
            .region(path, &field("segmentation"), limits)?;
        if let Some(region) = region {
            let regions = of_images.entry(annotation.image_id).or_default();
            regions.push((area(&region), index, region));
        }
    }
    let mut drawings = HashMap::new();
    let mut others = 0;
    for (id, mut regions) in of_images {
        let image = images[&id];
        let Some(frame) = frame_of(frames, &image.file_name) else {
            others += 1;
            continue;
        };
        let mut drawing = Drawing::new(path, image.width.zip(image.height));
        regions.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, index, region) in regions {
            let id = drawing.segment(&vocabulary, index, true)?;
            drawing.regions.push((id, region));
        }
        ensure!(drawings.insert(frame.name.to_owned(), drawing).is_none(),
            path, "images"; found "{} and another image of this photo", image.file_name;
            expected "one for each photo"; help "{DAMAGED_HELP}");
    }
    ensure!(!drawings.is_empty(),
        path, "annotations"; found "{others} images with regions, none of which is a photo of the scene";
        expected "polygons or run lengths on photos such as {}", frames.first().map_or("", |frame| frame.name);
        help "give images the file names of the photos, and draw polygons, not boxes");
    if others > 0 {
        let file = path.display();
        let other = format!("{others} labelled images of {file} are no photos of the scene");
        let notice = vocabulary.notice.take();
        vocabulary.notice =
            Some(notice.map_or(other.clone(), |notice| format!("{notice}; {other}")));
    }
    Ok((drawings, vocabulary))
}

/// The frame of an image: the one whose photo has this path. Photos that lie in one folder are found by their names alone.
fn frame_of<'a>(frames: &'a [RawFile<'a>], file_name: &str) -> Option<&'a RawFile<'a>> {
    // Windows' tools write its separators.
    let path = PathBuf::from(file_name.replace('\\', "/")).with_extension("");
    let folder = frames.first()?.photo.parent();
    let is_one_folder = frames.iter().all(|frame| frame.photo.parent() == folder);
    let wanted = if is_one_folder {
        Path::new(path.file_name()?)
    } else {
        path.as_path()
    };
    let mut found = frames
        .iter()
        .filter(|frame| frame.photo.with_extension("").ends_with(wanted));
    found.next().filter(|_| found.next().is_none())
}

/// Pixels that a region covers, where its outlines do not overlap.
fn area(region: &Region) -> f64 {
    match region {
        Region::Runs { counts, .. } => counts.iter().skip(1).step_by(2).sum::<u64>() as f64,
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
    Runs(Runs),
}

#[derive(Deserialize)]
struct Runs {
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

impl Default for Segmentation {
    fn default() -> Self {
        Self::Polygons(Vec::new())
    }
}

impl Segmentation {
    /// What it covers; `None` where it says nothing. `field` is named in errors.
    fn region(self, path: &Path, field: &str, limits: &Limits) -> Result<Option<Region>> {
        match self {
            Self::Polygons(lists) => {
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
            Self::Runs(Runs {
                size: [height, width],
                counts,
            }) => {
                limits.check_pixels(path, width, height)?;
                let pixels = width as u64 * height as u64;
                let counts = match counts {
                    Counts::Numbers(counts) => Some(counts),
                    Counts::Packed(text) => unpacked(&text),
                };
                let sum = |counts: &Vec<u64>| {
                    let add = |sum: u64, count: &u64| sum.checked_add(*count);
                    counts.iter().try_fold(0, add)
                };
                match counts.filter(|counts| pixels > 0 && sum(counts) == Some(pixels)) {
                    Some(counts) => Ok(Some(Region::Runs {
                        size: (width, height),
                        counts,
                    })),
                    None => Err(
                        invalid!(path, "{field}.counts"; found "run lengths of another number of pixels";
                        expected "{width}x{height} pixels in all"; help "{DAMAGED_HELP}"),
                    ),
                }
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
        // Of a picture of 9 x 10 pixels.
        let runs = vec![6, 1, 40, 4, 5, 4, 5, 4, 21];
        assert_eq!(unpacked("61X13mN000`0"), Some(runs));
    }
}
