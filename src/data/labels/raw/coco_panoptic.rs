//! COCO panoptic: a JSON file and PNG whose colours are segment ids, `R + 256 G + 65536 B`; 0 is unlabelled.
//!
//! Format: <https://cocodataset.org/#format-data>, 'Panoptic Segmentation'; Detectron2 and Mask2Former write it as
//! `predictions.json` beside the maps.

use super::{RawMap, Vocabulary};
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Segment};
use crate::error::{Result, ensure, invalid};
use crate::files;
use crate::files::check_limit;
use serde::{Deserialize, Deserializer};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

const EXPORT_TOGETHER: &str = "export JSON and maps together";

/// The file. Unknown keys are ignored.
#[derive(Deserialize)]
struct File {
    annotations: Vec<Annotation>,
    categories: Vec<Category>,
}

#[derive(Deserialize)]
struct Annotation {
    file_name: String,
    segments_info: Vec<SegmentInfo>,
}

#[derive(Deserialize)]
struct SegmentInfo {
    id: u32,
    category_id: u32,
    #[serde(default, deserialize_with = "flag")]
    isthing: Option<bool>,
}

#[derive(Deserialize)]
struct Category {
    id: u32,
    name: String,
    #[serde(default, deserialize_with = "flag")]
    isthing: Option<bool>,
}

/// COCO writes 0 and 1, Detectron2 false and true.
fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<bool>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Flag {
        Bool(bool),
        Number(u8),
    }
    let flag = Option::<Flag>::deserialize(deserializer)?;
    Ok(flag.map(|flag| match flag {
        Flag::Bool(set) => set,
        Flag::Number(number) => number != 0,
    }))
}

/// The segments of a map by their ids: class, and whether it is a thing.
type Segments = BTreeMap<u32, (Option<u16>, bool)>;

/// What the JSON file says.
pub(super) struct Panoptic {
    path: PathBuf,
    /// Segments of each map by its file stem.
    maps: HashMap<String, Segments>,
}

/// The JSON file of a folder of maps: beside it with its name, or within it.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    places(folder).into_iter().find(|path| path.is_file())
}

fn places(folder: &Path) -> [PathBuf; 3] {
    [
        folder.with_extension("json"),
        folder.join("panoptic.json"),
        folder.join("predictions.json"),
    ]
}

fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

impl Panoptic {
    /// Reads the JSON file of the maps in `folder`, for a scene with the class table `classes`.
    pub fn read(folder: &Path, classes: &Classes) -> Result<(Self, Vocabulary)> {
        let path = find(folder).ok_or_else(|| {
            let [beside, within, other] = places(folder).map(|path| path.display().to_string());
            invalid!(folder, "panoptic JSON"; found "no such file"; expected "{beside}, {within} or {other}";
                help "put it there")
        })?;
        let expected = "{\"annotations\": [{\"file_name\", \"segments_info\": [{\"id\", \"category_id\"}, ..]}, ..], \
            \"categories\": [{\"id\", \"name\", \"isthing\"}, ..]}";
        let file: File = files::json(&path, expected)?;
        const DAMAGED_HELP: &str = "export the panoptic JSON again";
        // Id 0 is unlabelled in a class table: where the file has a class 0, all ids move up by one.
        let shift = u32::from(file.categories.iter().any(|category| category.id == 0));
        let mut names = Vec::with_capacity(file.categories.len());
        let mut indices = HashMap::new();
        for (i, category) in file.categories.iter().enumerate() {
            let field = format!("categories[{i}].id");
            let id = category.id;
            let own = u16::try_from(id.saturating_add(shift)).map_err(
                |_| invalid!(&path, "{field}"; found "{id}"; expected "0 to 65534"; help "{DAMAGED_HELP}"),
            )?;
            ensure!(indices.insert(id, i).is_none(),
                &path, "{field}"; found "{id} twice"; expected "each id once"; help "{DAMAGED_HELP}");
            names.push((own, category.name.as_str()));
        }
        ensure!(!names.is_empty(),
            &path, "categories"; found "none"; expected "the classes of the segments"; help "{DAMAGED_HELP}");
        let count = names.len();
        let vocabulary = Vocabulary::new(&path, classes, names)?;
        let mut maps = HashMap::new();
        for (i, annotation) in file.annotations.iter().enumerate() {
            let field = format!("annotations[{i}] ({})", annotation.file_name);
            let mut segments = Segments::new();
            for (j, info) in annotation.segments_info.iter().enumerate() {
                let index = *indices.get(&info.category_id).ok_or_else(|| {
                    invalid!(&path, "{field}.segments_info[{j}].category_id"; found "{}", info.category_id;
                        expected "one of the {} ids of categories", count; help "{DAMAGED_HELP}")
                })?;
                let thing = file.categories[index]
                    .isthing
                    .or(info.isthing)
                    .unwrap_or(true);
                let segment = (vocabulary.ids[index], thing);
                ensure!(segments.insert(info.id, segment).is_none(),
                    &path, "{field}.segments_info"; found "id {} twice", info.id; expected "each id once"; help "{DAMAGED_HELP}");
            }
            let before = maps.insert(stem(Path::new(&annotation.file_name)), segments);
            ensure!(before.is_none(), &path, "{field}"; found "a second annotation of this file";
                expected "one for each file"; help "{DAMAGED_HELP}");
        }
        Ok((Self { path, maps }, vocabulary))
    }

    /// The segments of a map, numbered from 1 on in the order of their ids. Those whose class the scene does not have
    /// are unlabelled.
    pub fn decode(&self, path: &Path, file: &ImageFile) -> Result<RawMap> {
        ensure!(matches!(file.png_color(), Some((8, 2 | 6))), path, "pixel format"; found "another kind of file";
            expected "an RGB PNG of 8 bits whose colours are segment ids, R + 256 G + 65536 B";
            help "export it with panopticapi's id2rgb, or set data.raw_format");
        let listed = self.maps.get(&stem(path)).ok_or_else(|| {
            invalid!(&self.path, "annotations"; found "{} annotations, none for {}", self.maps.len(), path.display();
                expected "one for each map"; help "{EXPORT_TOGETHER}")
        })?;
        let what = format!("segments of {}", stem(path));
        let most = u64::from(u16::MAX) - 1;
        let count = listed.len() as u64;
        let help = "leave small segments out";
        check_limit(&self.path, &what, count, most, help)?;
        let mut numbers = HashMap::new();
        let mut segments = Vec::new();
        for ((&id, &(class, thing)), number) in listed.iter().zip(1..) {
            numbers.insert(id, if class.is_some() { number } else { 0 });
            segments.extend(class.map(|_| Segment {
                id: number,
                class,
                thing,
            }));
        }
        // 0 is unlabelled, whatever is listed.
        numbers.insert(0, 0);
        let image = file.decode()?.into_rgb8();
        let (width, height) = file.size;
        let mut ids = Vec::with_capacity(width * height);
        // Neighbours are mostly of one segment.
        let mut last = 0;
        let mut last_number = 0;
        for (i, pixel) in image.pixels().enumerate() {
            let [r, g, b] = pixel.0.map(u32::from);
            let id = r + 256 * g + 65_536 * b;
            if id != last {
                last = id;
                last_number = *numbers.get(&id).ok_or_else(|| {
                    invalid!(path, "pixel x {}, y {}", i % width, i / width; found "segment id {id}";
                        expected "one of the {} segments that {} lists", listed.len(), self.path.display();
                        help "{EXPORT_TOGETHER}")
                })?;
            }
            ids.push(last_number);
        }
        let map = LabelMap { width, height, ids };
        Ok(RawMap { map, segments })
    }
}
