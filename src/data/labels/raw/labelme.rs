//! LabelMe: a JSON file for each photo with labelled shapes. Later shapes lie over earlier ones.
//!
//! Format: <https://github.com/wkentaro/labelme>, version 4 and later. Points and lines have no area and label nothing.

use super::drawing::{self, Drawing, Point, Region};
use super::runs::Runs;
use super::shape_labels::ShapeLabels;
use super::{RawFile, Vocabulary, masks};
use crate::data::Classes;
use crate::data::photos::image_file::ImageFile;
use crate::error::{Error, Result, invalid};
use crate::files::{check_limit, check_pixels};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;
use std::collections::HashMap;
use std::path::Path;

/// Runs of pixels inside and outside of all masks of a photo.
const MAX_RUNS: u64 = 1 << 22;

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
    /// Of a mask: a PNG of its box, in base64.
    mask: Option<String>,
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
    let folder = crate::files::folder(files[0].0.path);
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
        let size = self.width.zip(self.height);
        let mut drawing = Drawing::new(path, size);
        let mut runs = 0;
        for (i, shape) in self.shapes.iter().enumerate() {
            let Some(region) = shape.region(path, i, size)? else {
                continue;
            };
            if let Region::Runs(mask) = &region {
                runs += mask.count() as u64;
                let help = "draw polygons around what is so fine";
                check_limit(path, "runs of pixels of masks", runs, MAX_RUNS, help)?;
            }
            let group = shape.group_id.as_ref().map(ToString::to_string);
            labels.draw(&mut drawing, &shape.label, group, region)?;
        }
        Ok(drawing)
    }
}

impl Shape {
    fn error(&self, path: &Path, i: usize, field: &str, found: &str, expected: &str) -> Error {
        invalid!(path, "shapes[{i}] ({}).{field}", self.label; found "{found}"; expected "{expected}";
            help "correct the shape in LabelMe, or remove it")
    }

    /// What it covers of a picture of the size `picture`, where that is known; `None` for shapes without area.
    fn region(
        &self,
        path: &Path,
        i: usize,
        picture: Option<(usize, usize)>,
    ) -> Result<Option<Region>> {
        let kind = self.shape_type.as_deref().unwrap_or("polygon");
        let points = &self.points;
        let error =
            |field: &str, found: &str, expected: &str| self.error(path, i, field, found, expected);
        let polygon = match (kind, &points[..]) {
            ("point" | "points" | "line" | "linestrip", _) => return Ok(None),
            ("mask", [a, b]) => return self.mask(path, i, picture, [*a, *b]).map(Some),
            ("rectangle", [a, b]) => drawing::rectangle(*a, *b),
            ("circle", [[x, y], rim]) => {
                let radius = (rim[0] - x).hypot(rim[1] - y);
                drawing::ellipse([*x, *y], [radius; 2])
            }
            ("polygon" | "rectangle" | "oriented_rectangle", [_, _, _, ..]) => points.clone(),
            ("polygon" | "rectangle" | "oriented_rectangle" | "circle" | "mask", _) => {
                let found = format!("{} of a {kind}", points.len());
                let expected = "a polygon of 3 or more, two corners of a rectangle or mask, or centre and rim of a circle";
                return Err(error("points", &found, expected));
            }
            _ => {
                let expected =
                    "polygon, rectangle, circle or mask (points and lines label nothing)";
                return Err(error("shape_type", &format!("{kind:?}"), expected));
            }
        };
        Ok(Some(Region::Polygons(vec![polygon])))
    }

    /// A mask: the pixels of a box that are not black in a PNG. `first` and `last` are the corners of the box.
    fn mask(
        &self,
        path: &Path,
        i: usize,
        picture: Option<(usize, usize)>,
        [first, last]: [Point; 2],
    ) -> Result<Region> {
        let error = |found: &str, expected: &str| self.error(path, i, "mask", found, expected);
        let no_size = || error("no imageWidth and imageHeight", "the size of its picture");
        let picture = picture.ok_or_else(no_size)?;
        check_pixels(path, picture.0, picture.1)?;
        let ((width, height), inside) = self.pixels(path, error)?;
        // LabelMe cuts coordinates off. The second corner is the last pixel, or the one behind it.
        let [[left, top], [right, bottom]] = [first, last].map(|point| point.map(f64::trunc));
        let [across, down] = [right - left, bottom - top].map(|length| length + 1.0);
        let fits = |pixels: usize, length: f64| [length, length - 1.0].contains(&(pixels as f64));
        let is_box = left >= 0.0 && top >= 0.0 && fits(width, across) && fits(height, down);
        let corner = (left as usize, top as usize);
        let runs = Runs::of_pixels(picture, corner, (width, height), &inside);
        let runs = runs.filter(|_| is_box).ok_or_else(|| {
            let found = format!("{width}x{height} pixels for {across}x{down} at {left}, {top}");
            let expected = format!(
                "those of its box in a picture of {}x{}",
                picture.0, picture.1
            );
            error(&found, &expected)
        })?;
        Ok(Region::Runs(runs))
    }

    /// The size of a mask, and its pixels row by row.
    fn pixels(
        &self,
        path: &Path,
        error: impl Fn(&str, &str) -> Error,
    ) -> Result<((usize, usize), Vec<bool>)> {
        let expected = "a grey PNG in base64";
        let text = self.mask.as_deref();
        let text = text.ok_or_else(|| error("nothing", expected))?;
        let bytes = STANDARD.decode(text);
        let bytes = bytes.map_err(|e| error(&e.to_string(), expected))?;
        let read = || {
            let file = ImageFile::from_bytes(path, bytes)?;
            Ok((file.size, masks::covered(path, &file)?))
        };
        read().map_err(|e| match e {
            Error::Input { found, .. } => error(&found, expected),
            other => other,
        })
    }
}
