//! COCO panoptic: a JSON file and PNG whose colours are segment ids, `R + 256 G + 65536 B`; 0 is unlabelled.
//!
//! Format: <https://cocodataset.org/#format-data>, 'Panoptic Segmentation'; Detectron2 and Mask2Former write it as
//! `predictions.json` beside the maps.

use super::{RawMap, Vocabulary};
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap, Segment};
use crate::error::{Error, Result};
use serde::Deserialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

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
    isthing: Option<Flag>,
}

#[derive(Deserialize)]
struct Category {
    id: u32,
    name: String,
    isthing: Option<Flag>,
}

/// COCO writes 0 and 1, Detectron2 false and true.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
enum Flag {
    Bool(bool),
    Number(u8),
}

impl Flag {
    fn is_set(self) -> bool {
        match self {
            Self::Bool(set) => set,
            Self::Number(number) => number != 0,
        }
    }
}

/// A segment of a photo.
struct Listed {
    id: u32,
    class: Option<u16>,
    thing: bool,
}

/// What the JSON file says.
pub(crate) struct Panoptic {
    path: PathBuf,
    /// Segments of each map by its file stem.
    maps: HashMap<String, Vec<Listed>>,
    vocabulary: Vocabulary,
}

/// The JSON file of a folder of maps: beside it with its name, or within it.
pub(crate) fn find(folder: &Path) -> Option<PathBuf> {
    places(folder).into_iter().find(|path| path.is_file())
}

fn places(folder: &Path) -> [PathBuf; 3] {
    [
        folder.with_extension("json"),
        folder.join("panoptic.json"),
        folder.join("predictions.json"),
    ]
}

impl Panoptic {
    /// Reads the JSON file of the maps in `folder`, for a scene with the class table `classes`.
    pub fn read(folder: &Path, classes: &Classes) -> Result<Self> {
        let again = "export the panoptic JSON again";
        let Some(path) = find(folder) else {
            let [beside, within, other] = places(folder).map(|path| path.display().to_string());
            let expected = format!("{beside}, {within} or {other}");
            return Err(Error::input(
                folder,
                "panoptic JSON",
                "no such file",
                expected,
                "put it there",
            ));
        };
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, "read", e))?;
        let file: File = serde_json::from_str(&text).map_err(|e| {
            let expected = "{\"annotations\": [{\"file_name\", \"segments_info\": [{\"id\", \"category_id\"}, ..]}, ..], \
                            \"categories\": [{\"id\", \"name\", \"isthing\"}, ..]}";
            Error::input(&path, format!("line {}", e.line()), e.to_string(), expected, again)
        })?;
        let mut names = Vec::with_capacity(file.categories.len());
        let mut places = HashMap::new();
        for (i, category) in file.categories.iter().enumerate() {
            let field = format!("categories[{i}].id");
            // Id 0 is unlabelled in a class table of ours: where the file has a class 0, all ids move up by one.
            let id = category
                .id
                .saturating_add(u32::from(file.categories.iter().any(|c| c.id == 0)));
            let Ok(own) = u16::try_from(id) else {
                return Err(Error::input(
                    &path,
                    field,
                    category.id.to_string(),
                    "0 to 65534",
                    "renumber the categories",
                ));
            };
            if places.insert(category.id, i).is_some() {
                return Err(Error::input(
                    &path,
                    field,
                    format!("{} twice", category.id),
                    "each id once",
                    again,
                ));
            }
            names.push((own, category.name.as_str()));
        }
        if names.is_empty() {
            return Err(Error::input(
                &path,
                "categories",
                "none",
                "the classes of the segments",
                again,
            ));
        }
        let vocabulary = Vocabulary::new(&path, classes, &names)?;
        let mut maps = HashMap::new();
        for (i, annotation) in file.annotations.iter().enumerate() {
            let field = format!("annotations[{i}] ({})", annotation.file_name);
            let mut listed = Vec::with_capacity(annotation.segments_info.len());
            for (j, info) in annotation.segments_info.iter().enumerate() {
                let Some(&category) = places.get(&info.category_id) else {
                    let field = format!("{field}.segments_info[{j}].category_id");
                    let expected = format!("one of the {} ids of categories", names.len());
                    return Err(Error::input(
                        &path,
                        field,
                        info.category_id.to_string(),
                        expected,
                        again,
                    ));
                };
                let thing = file.categories[category]
                    .isthing
                    .or(info.isthing)
                    .is_none_or(Flag::is_set);
                listed.push(Listed {
                    id: info.id,
                    class: vocabulary.ids[category],
                    thing,
                });
            }
            listed.sort_by_key(|segment| segment.id);
            if let Some(pair) = listed.windows(2).find(|pair| pair[0].id == pair[1].id) {
                let field = format!("{field}.segments_info");
                return Err(Error::input(
                    &path,
                    field,
                    format!("id {} twice", pair[0].id),
                    "each id once",
                    again,
                ));
            }
            let stem = Path::new(&annotation.file_name)
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if maps.insert(stem, listed).is_some() {
                return Err(Error::input(
                    &path,
                    field,
                    "a second annotation of this file",
                    "one a file",
                    again,
                ));
            }
        }
        Ok(Self {
            path,
            maps,
            vocabulary,
        })
    }

    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// The segments of a map, numbered from 1 on in the order of their ids. Those whose class the scene does not have
    /// are unlabelled.
    pub fn decode(&self, path: &Path, file: &ImageFile) -> Result<RawMap> {
        if !matches!(file.png_color(), Some((8, 2 | 6))) {
            let expected =
                "an RGB PNG of 8 bits whose colours are segment ids, R + 256 G + 65536 B";
            let help = "export it with panopticapi's id2rgb, or set data.raw_format";
            return Err(Error::input(
                path,
                "pixel format",
                "another kind of file",
                expected,
                help,
            ));
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let Some(listed) = self.maps.get(&*stem) else {
            let found = format!(
                "{} annotations, none for {}",
                self.maps.len(),
                path.display()
            );
            let help = "export JSON and maps together";
            return Err(Error::input(
                &self.path,
                "annotations",
                found,
                "one for each map",
                help,
            ));
        };
        if listed.len() >= usize::from(u16::MAX) {
            return Err(Error::Limit {
                what: format!("{}: segments of {stem}", self.path.display()),
                found: listed.len().to_string(),
                limit: (u16::MAX - 1).to_string(),
                help: "leave small segments out".into(),
            });
        }
        let image = file.decode()?.into_rgb8();
        let (width, height) = file.size;
        let mut ids = Vec::with_capacity(width * height);
        // Neighbours are mostly of one segment.
        let (mut last, mut last_id) = (0, 0);
        for (i, pixel) in image.pixels().enumerate() {
            let [r, g, b] = pixel.0.map(u32::from);
            let id = r + 256 * g + 65_536 * b;
            if id != last {
                (last, last_id) = (id, self.place(listed, id, path, (i % width, i / width))?);
            }
            ids.push(last_id);
        }
        let segment = |(listed, id): (&Listed, u16)| {
            listed.class.map(|class| Segment {
                id,
                class: Some(class),
                thing: listed.thing,
            })
        };
        let segments = listed.iter().zip(1..).filter_map(segment).collect();
        Ok(RawMap {
            map: LabelMap { width, height, ids },
            segments,
        })
    }

    /// Number of the segment with this id, 0 for none.
    fn place(
        &self,
        listed: &[Listed],
        id: u32,
        path: &Path,
        (x, y): (usize, usize),
    ) -> Result<u16> {
        if id == 0 {
            return Ok(0);
        }
        match listed.binary_search_by_key(&id, |segment| segment.id) {
            Ok(i) if listed[i].class.is_none() => Ok(0),
            Ok(i) => Ok(i as u16 + 1),
            Err(_) => {
                let found = format!("segment id {id}");
                let expected = format!(
                    "one of the {} segments that {} lists",
                    listed.len(),
                    self.path.display()
                );
                let help = "export JSON and maps together";
                Err(Error::input(
                    path,
                    format!("pixel x {x}, y {y}"),
                    found,
                    expected,
                    help,
                ))
            }
        }
    }
}
