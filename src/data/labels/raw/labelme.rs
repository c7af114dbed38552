//! LabelMe: a JSON file for each photo with labelled shapes. Later shapes lie over earlier ones.
//!
//! Format: <https://github.com/wkentaro/labelme>, version 4 and later. Points and lines have no area and label nothing.

use super::drawing::{self, Drawing, Point, Region};
use super::shape_labels::ShapeLabels;
use super::{RawFile, Vocabulary};
use crate::data::Classes;
use crate::error::{Error, Result, invalid};
use serde::Deserialize;
use std::collections::HashMap;
use std::path::Path;

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
    let first = files[0].0.path;
    let folder = first.parent().unwrap_or(first);
    let shapes = files.iter().flat_map(|(_, file)| &file.shapes);
    let labels = ShapeLabels::new(folder, classes, shapes.map(|shape| &*shape.label))?;
    let drawings = files.iter().map(|(raw, file)| {
        let drawing = file.drawing(raw.path, &labels)?;
        Ok((raw.name.to_owned(), drawing))
    });
    Ok((drawings.collect::<Result<_>>()?, labels.vocabulary))
}

impl File {
    fn drawing(&self, path: &Path, labels: &ShapeLabels) -> Result<Drawing> {
        let mut drawing = Drawing::new(path, self.width.zip(self.height));
        for (i, shape) in self.shapes.iter().enumerate() {
            let Some(region) = shape.region(path, i)? else {
                continue;
            };
            let group = shape.group_id.as_ref().map(ToString::to_string);
            labels.draw(&mut drawing, &shape.label, group, region)?;
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
            ("rectangle", [a, b]) => drawing::rectangle(*a, *b),
            ("circle", [[x, y], rim]) => {
                let radius = (rim[0] - x).hypot(rim[1] - y);
                drawing::ellipse([*x, *y], [radius; 2])
            }
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
