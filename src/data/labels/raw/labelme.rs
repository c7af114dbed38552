//! LabelMe: a JSON file for each photo with labelled shapes. Later shapes lie over earlier ones.
//!
//! Format: <https://github.com/wkentaro/labelme>, version 4 and later. Points and lines have no area and label nothing.

use super::drawing::{self, Drawing, Point, Region};
use super::{RawFile, Vocabulary};
use crate::data::Classes;
use crate::data::labels::classes::{is_void, plain};
use crate::error::{Error, Result, ensure, invalid};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Corners of the polygon that stands for a circle: its area is 0.1 % smaller.
const CORNERS: usize = 80;
/// LabelMe's own names for pixels without a label.
const UNLABELLED_NAMES: [&str; 2] = ["__ignore__", "_background_"];

/// The file. Unknown keys are ignored.
#[derive(Deserialize)]
struct File {
    shapes: Vec<Shape>,
    #[serde(rename = "imageWidth")]
    width: Option<usize>,
    #[serde(rename = "imageHeight")]
    height: Option<usize>,
}

#[derive(Deserialize)]
struct Shape {
    label: String,
    points: Vec<Point>,
    shape_type: Option<String>,
    /// Shapes of one label and group are one thing.
    group_id: Option<serde_json::Value>,
}

/// Whether a JSON file is LabelMe's.
pub(crate) fn has_shapes(file: &Path) -> bool {
    crate::files::text(file).is_ok_and(|text| text.contains("\"shapes\""))
}

/// Reads `labelled`, for a scene with the class table `classes`: drawings by the names of the frames.
pub(super) fn read(
    labelled: &[RawFile],
    classes: &Classes,
) -> Result<(HashMap<String, Drawing>, Vocabulary)> {
    let expected = "{\"shapes\": [{\"label\", \"points\": [[x, y], ..], \"shape_type\"}, ..], \"imageWidth\", \"imageHeight\"}";
    let files = labelled
        .iter()
        .map(|raw| Ok((raw, drawing::read::<File>(raw.path, expected)?)))
        .collect::<Result<Vec<_>>>()?;
    let shapes = files.iter().flat_map(|(_, file)| &file.shapes);
    let labels: BTreeMap<String, &str> = shapes
        .filter(|shape| !is_unlabelled(&shape.label))
        .map(|shape| (plain(&shape.label), shape.label.trim()))
        .collect();
    let first = files[0].0.path;
    let folder = first.parent().unwrap_or(first);
    ensure!(!labels.is_empty(),
        folder, "shapes"; found "none with a label"; expected "the outlines of objects, with their classes";
        help "draw polygons in LabelMe and save them");
    let names: Vec<(u16, &str)> = (1..).zip(labels.values().copied()).collect();
    let vocabulary = Vocabulary::new(folder, classes, &names)?;
    let indices: HashMap<&str, usize> = labels.keys().map(String::as_str).zip(0..).collect();
    let drawings = files.iter().map(|(raw, file)| {
        let drawing = file.drawing(raw.path, &vocabulary, &indices)?;
        Ok((raw.name.to_owned(), drawing))
    });
    Ok((drawings.collect::<Result<_>>()?, vocabulary))
}

fn is_unlabelled(label: &str) -> bool {
    is_void(label) || UNLABELLED_NAMES.contains(&label.trim())
}

impl File {
    fn drawing(
        &self,
        path: &Path,
        vocabulary: &Vocabulary,
        indices: &HashMap<&str, usize>,
    ) -> Result<Drawing> {
        let mut drawing = Drawing::new(path, self.width.zip(self.height));
        let mut groups = HashMap::new();
        for (i, shape) in self.shapes.iter().enumerate() {
            let label = plain(&shape.label);
            let index = indices.get(label.as_str()).copied();
            let group = shape.group_id.as_ref().map(|id| (index, id.to_string()));
            let Some(region) = shape.region(path, i)? else {
                continue;
            };
            let known = group.as_ref().and_then(|group| groups.get(group)).copied();
            let id = match (known, index) {
                (Some(id), _) => id,
                (None, Some(index)) => drawing.segment(vocabulary, index, true)?,
                (None, None) => 0,
            };
            groups.extend(group.map(|group| (group, id)));
            drawing.regions.push((id, region));
        }
        Ok(drawing)
    }
}

impl Shape {
    /// What it covers; `None` for shapes without area.
    fn region(&self, path: &Path, i: usize) -> Result<Option<Region>> {
        let kind = self.shape_type.as_deref().unwrap_or("polygon");
        let points = &self.points;
        let error = |field: &str, found: String, expected: &str| -> Error {
            invalid!(path, "shapes[{i}] ({}).{field}", self.label; found "{found}"; expected "{expected}";
                help "correct the shape in LabelMe, or remove it")
        };
        let polygon = match (kind, &points[..]) {
            ("point" | "points" | "line" | "linestrip", _) => return Ok(None),
            ("rectangle", [a, b]) => vec![*a, [b[0], a[1]], *b, [a[0], b[1]]],
            ("circle", [center, rim]) => circle(*center, *rim),
            ("polygon" | "rectangle" | "oriented_rectangle", [_, _, _, ..]) => points.clone(),
            ("polygon" | "rectangle" | "oriented_rectangle" | "circle", _) => {
                let found = format!("{} of a {kind}", points.len());
                let expected = "a polygon of 3 or more, two corners of a rectangle, or centre and rim of a circle";
                return Err(error("points", found, expected));
            }
            _ => {
                let expected = "polygon, rectangle or circle (points and lines label nothing)";
                return Err(error("shape_type", format!("{kind:?}"), expected));
            }
        };
        Ok(Some(Region::Polygons(vec![polygon])))
    }
}

/// A circle as a polygon.
fn circle([x, y]: Point, rim: Point) -> Vec<Point> {
    let radius = (rim[0] - x).hypot(rim[1] - y);
    let corner = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
        [x + radius * cos, y + radius * sin]
    };
    (0..CORNERS).map(corner).collect()
}
