//! CVAT for images: one XML file for all photos. Shapes are painted in their order of depth, those of one depth in the order of the file.
//!
//! Format: <https://docs.cvat.ai/docs/other/xml_format>, version 1.1. Lines, points, cuboids and tags label nothing.

use super::drawing::{self, Drawing, Point, Region};
use super::runs::Runs;
use super::shape_file::drawings;
use super::shape_labels::ShapeLabels;
use super::{RawFile, Vocabulary};
use crate::data::Classes;
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{self, check_limit, check_pixels};
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::HashMap;
use std::path::Path;
use std::str::FromStr;

/// Bytes of a file.
const MAX_BYTES: u64 = 1 << 28;
/// Attributes of an element, which the parser compares each with each.
const MAX_ATTRIBUTES: u64 = 256;
/// Elements and texts of a file.
const MAX_NODES: u32 = 1 << 24;
const DAMAGED_HELP: &str = "export it again from CVAT, as \"CVAT for images 1.1\"";
/// Elements of an image that have no area.
const WITHOUT_AREA: [&str; 5] = ["polyline", "points", "cuboid", "skeleton", "tag"];

/// Reads the file at `path` for a scene with the class table `classes`: drawings by the names of those frames that have shapes.
pub(super) fn read(
    path: &Path,
    frames: &[RawFile],
    classes: &Classes,
) -> Result<(HashMap<String, Drawing>, Vocabulary)> {
    let text = text(path)?;
    let options = ParsingOptions {
        nodes_limit: MAX_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(&text, options).map_err(|e| {
        invalid!(path, "XML"; found "{e}"; expected "<annotations> with <image> elements"; help "{DAMAGED_HELP}")
    })?;
    let root = Element {
        path,
        node: document.root_element(),
    };
    ensure!(root.tag() == "annotations",
        path, "{}", root.place(); found "<{}>", root.tag(); expected "<annotations>"; help "{DAMAGED_HELP}");
    let images: Vec<Element> = root.children().filter(|e| e.tag() == "image").collect();
    ensure!(!images.is_empty(),
        path, "annotations"; found "no <image>"; expected "images with shapes"; help "{DAMAGED_HELP}");
    let of_images = images
        .iter()
        .map(|image| image.shapes())
        .collect::<Result<Vec<_>>>()?;
    let names = of_images.iter().flatten().map(|shape| shape.label);
    let mut labels = ShapeLabels::new(path, classes, names)?;
    let mut drawn = Vec::new();
    for (image, mut shapes) in images.iter().zip(of_images) {
        if shapes.is_empty() {
            continue;
        }
        shapes.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        let name = image.required("name")?;
        let mut drawing = Drawing::new(path, Some(image.size()?));
        for shape in shapes {
            labels.draw(&mut drawing, shape.label, shape.group, shape.region)?;
        }
        drawn.push((name, drawing));
    }
    let drawings = drawings(path, frames, drawn, &mut labels.vocabulary)?;
    Ok((drawings, labels.vocabulary))
}

/// The text of the file, within the limits on what a parser takes.
fn text(path: &Path) -> Result<String> {
    drawing::check_size(path, MAX_BYTES)?;
    let text = files::text(path)?;
    // Attributes have no < in them, and each has a sign of equality.
    let equals = |tag: &str| tag.bytes().filter(|byte| *byte == b'=').count() as u64;
    let most = text.split('<').map(equals).max().unwrap_or_default();
    let what = "attributes of an element";
    check_limit(path, what, most, MAX_ATTRIBUTES, DAMAGED_HELP)?;
    Ok(text)
}

/// A shape of an image.
struct Labelled<'a> {
    label: &'a str,
    group: Option<String>,
    /// `z_order`: shapes with larger ones lie above.
    depth: f64,
    region: Region,
}

/// An element of the file at `path`.
#[derive(Clone, Copy)]
struct Element<'a> {
    path: &'a Path,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    fn children(&self) -> impl Iterator<Item = Element<'a>> {
        let path = self.path;
        let elements = self.node.children().filter(Node::is_element);
        elements.map(move |node| Self { path, node })
    }

    /// Where it stands, for errors.
    fn place(&self) -> String {
        let start = self.node.range().start;
        let line = self.node.document().text_pos_at(start).row;
        format!("line {line}, <{}>", self.tag())
    }

    fn error(&self, attribute: &str, found: &str, expected: &str) -> Error {
        invalid!(self.path, "{}, {attribute}", self.place(); found "{found}"; expected "{expected}"; help "{DAMAGED_HELP}")
    }

    fn required(&self, attribute: &str) -> Result<&'a str> {
        let value = self.node.attribute(attribute);
        value.ok_or_else(|| self.error(attribute, "nothing", "a value"))
    }

    fn parsed<T: FromStr>(&self, attribute: &str, expected: &str) -> Result<T> {
        let value = self.required(attribute)?;
        let parsed = value.trim().parse();
        parsed.map_err(|_| self.error(attribute, &format!("{value:?}"), expected))
    }

    /// A finite number.
    fn number(&self, attribute: &str) -> Result<f64> {
        let value: f64 = self.parsed(attribute, "a number")?;
        ensure!(value.is_finite(), self.path, "{}, {attribute}", self.place(); found "{value}";
            expected "a finite number"; help "{DAMAGED_HELP}");
        Ok(value)
    }

    /// A number that may be left out, which means 0.
    fn number_or_zero(&self, attribute: &str) -> Result<f64> {
        let is_there = self.node.has_attribute(attribute);
        if is_there {
            self.number(attribute)
        } else {
            Ok(0.0)
        }
    }

    fn pixels(&self, attribute: &str) -> Result<usize> {
        self.parsed(attribute, "a number of pixels")
    }

    fn size(&self) -> Result<(usize, usize)> {
        Ok((self.pixels("width")?, self.pixels("height")?))
    }

    /// The shapes of an image that have an area.
    fn shapes(&self) -> Result<Vec<Labelled<'a>>> {
        let mut shapes = Vec::new();
        for shape in self.children() {
            if WITHOUT_AREA.contains(&shape.tag()) {
                continue;
            }
            shapes.push(Labelled {
                label: shape.required("label")?,
                group: shape.node.attribute("group_id").map(str::to_owned),
                depth: shape.number_or_zero("z_order")?,
                region: shape.region(self)?,
            });
        }
        Ok(shapes)
    }

    /// What a shape covers of `image`.
    fn region(&self, image: &Self) -> Result<Region> {
        let polygon = match self.tag() {
            "polygon" => self.points()?,
            "box" => {
                let corner = [self.number("xtl")?, self.number("ytl")?];
                let opposite = [self.number("xbr")?, self.number("ybr")?];
                let center = [0, 1].map(|i| 0.5 * (corner[i] + opposite[i]));
                self.turned(drawing::rectangle(corner, opposite), center)?
            }
            "ellipse" => {
                let center = [self.number("cx")?, self.number("cy")?];
                let radii = [self.number("rx")?, self.number("ry")?];
                self.turned(drawing::ellipse(center, radii), center)?
            }
            "mask" => return Ok(Region::Runs(self.mask(image)?)),
            other => bail!(self.path, "{}", self.place(); found "<{other}>";
                expected "polygon, box, ellipse or mask ({} label nothing)", WITHOUT_AREA.join(", ");
                help "{DAMAGED_HELP}"),
        };
        Ok(Region::Polygons(vec![polygon]))
    }

    /// `points`: `x,y;x,y` and so on.
    fn points(&self) -> Result<Vec<Point>> {
        let text = self.required("points")?;
        let point = |pair: &str| {
            let (x, y) = pair.split_once(',')?;
            Some([x.trim().parse().ok()?, y.trim().parse().ok()?])
        };
        let points: Option<Vec<Point>> = text.split(';').map(point).collect();
        let points = points.filter(|points| points.len() > 2);
        let expected = "x,y;x,y;.. of three points or more";
        points.ok_or_else(|| self.error("points", &format!("{text:?}"), expected))
    }

    /// `polygon` turned about `center` by `rotation`, in degrees from x to y.
    fn turned(&self, mut polygon: Vec<Point>, center: Point) -> Result<Vec<Point>> {
        let angle = self.number_or_zero("rotation")?;
        if angle != 0.0 {
            let (sin, cos) = angle.to_radians().sin_cos();
            for point in &mut polygon {
                let [x, y] = [point[0] - center[0], point[1] - center[1]];
                *point = [center[0] + cos * x - sin * y, center[1] + sin * x + cos * y];
            }
        }
        Ok(polygon)
    }

    /// A mask: run lengths along the rows of a box of `image`.
    fn mask(&self, image: &Self) -> Result<Runs> {
        let picture = image.size()?;
        check_pixels(self.path, picture.0, picture.1)?;
        let corner = (self.pixels("left")?, self.pixels("top")?);
        let size = self.size()?;
        let text = self.required("rle")?;
        let counts: Option<Vec<u64>> = text
            .split(',')
            .map(|count| count.trim().parse().ok())
            .collect();
        let runs = counts.and_then(|counts| Runs::of_rows(picture, corner, size, counts));
        runs.ok_or_else(|| {
            let (left, top) = corner;
            let (width, height) = size;
            let (across, down) = picture;
            let found = format!("a box of {width}x{height} at {left}, {top} with {text:?}");
            let expected = format!("run lengths that fill a box of a picture of {across}x{down}");
            self.error("rle", &found, &expected)
        })
    }
}
