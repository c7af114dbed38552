//! Labels that somebody drew on a photo: regions with classes, painted over one another.

use super::runs::Runs;
use super::{RawMap, Vocabulary};
use crate::data::photos::image_file::{TURNED_HELP, proportional};
use crate::data::{LabelMap, Segment};
use crate::error::{Error, Result, bail};
use crate::files::{self, check_limit};
use serde::de::DeserializeOwned;
use std::collections::HashMap;
use std::f64::consts::TAU;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Bytes of a JSON file of drawings.
const MAX_BYTES: u64 = 1 << 29;
/// Points of all outlines on one photo.
const MAX_POINTS: u64 = 1 << 18;
/// Corners of the polygon that stands for an ellipse: its area is 0.1 % smaller.
const CORNERS: usize = 80;

/// Pixel coordinates (x, y); the centre of the first pixel is (0.5, 0.5).
pub(super) type Point = [f64; 2];

/// A part of a photo.
pub(super) enum Region {
    /// The union of closed polygons.
    Polygons(Vec<Vec<Point>>),
    Runs(Runs),
}

/// The labels of a photo, in the order in which they are painted.
pub(crate) struct Drawing {
    /// The file that it was read from.
    pub file: PathBuf,
    /// Size of the picture that it was drawn on, where the file gives it.
    pub size: Option<(usize, usize)>,
    /// The segment of each region, 0 for regions without a label.
    regions: Vec<(u16, Region)>,
    segments: Vec<Segment>,
    /// The segments of groups, by class and name.
    groups: HashMap<(Option<usize>, String), u16>,
}

/// A JSON file of acceptable size.
pub(super) fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
    check_size(path, MAX_BYTES)?;
    files::json(path, expected)
}

/// Refuses a file of drawings of more than `most` bytes.
pub(super) fn check_size(path: &Path, most: u64) -> Result<()> {
    let size = std::fs::metadata(path).map_err(|e| Error::io(path, "look at", e))?;
    check_limit(path, "bytes", size.len(), most, "divide the file")
}

impl Drawing {
    pub fn new(file: &Path, size: Option<(usize, usize)>) -> Self {
        Self {
            file: file.to_owned(),
            size,
            regions: Vec::new(),
            segments: Vec::new(),
            groups: HashMap::new(),
        }
    }

    /// Puts a region over the earlier ones: a segment of the class `index` of `vocabulary`, or of no class. Regions of one class and
    /// group are one segment.
    pub(super) fn add(
        &mut self,
        vocabulary: &Vocabulary,
        index: Option<usize>,
        group: Option<String>,
        region: Region,
    ) -> Result<()> {
        let group = group.map(|group| (index, group));
        let known = group.as_ref().and_then(|group| self.groups.get(group));
        let id = match (known, index) {
            (Some(id), _) => *id,
            (None, Some(index)) => self.segment(vocabulary, index)?,
            (None, None) => 0,
        };
        self.groups.extend(group.map(|group| (group, id)));
        self.regions.push((id, region));
        Ok(())
    }

    /// A new segment of class `index` of `vocabulary`: its number, or 0 if the scene does not have the class.
    fn segment(&mut self, vocabulary: &Vocabulary, index: usize) -> Result<u16> {
        let Some(class) = vocabulary.ids[index] else {
            return Ok(0);
        };
        let count = self.segments.len() as u64 + 1;
        let most = u64::from(u16::MAX) - 1;
        check_limit(&self.file, "shapes of a photo", count, most, "join shapes")?;
        let id = count as u16;
        self.segments.push(Segment {
            id,
            class: Some(class),
            thing: true,
        });
        Ok(id)
    }

    /// Refuses outlines of a picture other than a photo of the size `photo`, and more points than can be filled.
    fn check(&self, photo: (usize, usize)) -> Result<(f64, f64)> {
        let (width, height) = self.size.unwrap_or(photo);
        if width == 0 || height == 0 || !proportional((width, height), photo) {
            let turned = width > 0 && height > 0 && proportional((height, width), photo);
            let help = if turned {
                TURNED_HELP
            } else {
                "draw on this photo, or correct the size in the file"
            };
            bail!(&self.file, "size of the picture"; found "{width}x{height} pixels";
                expected "{}x{}, as its photo, or that size reduced", photo.0, photo.1; help "{help}");
        }
        let polygons = self.regions.iter().flat_map(|(_, region)| match region {
            Region::Polygons(polygons) => polygons.as_slice(),
            Region::Runs(_) => &[],
        });
        let points = polygons.clone().map(|polygon| polygon.len() as u64).sum();
        let help = "draw with fewer points, or export label maps";
        check_limit(&self.file, "points on a photo", points, MAX_POINTS, help)?;
        let size = [width as f64, height as f64];
        let far = |point: &&Point| (0..2).any(|i| !(-size[i]..=2.0 * size[i]).contains(&point[i]));
        if let Some([x, y]) = polygons.flatten().find(far) {
            bail!(&self.file, "points"; found "x {x}, y {y}";
                expected "pixel coordinates of a picture of {width}x{height}"; help "export the shapes again");
        }
        Ok((photo.0 as f64 / size[0], photo.1 as f64 / size[1]))
    }

    /// The map of the segments on a photo of the size `photo`; pixels outside all regions are 0.
    pub fn paint(&self, photo: (usize, usize)) -> Result<RawMap> {
        let (across, down) = self.check(photo)?;
        let (width, height) = photo;
        let mut ids = vec![0; width * height];
        for (id, region) in &self.regions {
            match region {
                Region::Polygons(polygons) => {
                    for polygon in polygons {
                        let scaled: Vec<Point> = polygon
                            .iter()
                            .map(|[x, y]| [x * across, y * down])
                            .collect();
                        fill(&scaled, photo, |y, run| ids[y * width..][run].fill(*id));
                    }
                }
                Region::Runs(runs) => runs.paint(photo, |pixel| ids[pixel] = *id),
            }
        }
        let map = LabelMap { width, height, ids };
        let segments = self.segments.clone();
        Ok(RawMap { map, segments })
    }
}

/// Calls `run` with row and columns of the pixels whose centres lie inside `polygon`, by the even-odd rule.
fn fill(
    polygon: &[Point],
    (width, height): (usize, usize),
    mut run: impl FnMut(usize, Range<usize>),
) {
    // The first pixel whose centre is not before `edge`.
    let first = |edge: f64, most: usize| (edge - 0.5).ceil().clamp(0.0, most as f64) as usize;
    let ys = || polygon.iter().map(|point| point[1]);
    let top = ys().fold(f64::INFINITY, f64::min);
    let bottom = ys().fold(f64::NEG_INFINITY, f64::max);
    let mut crossings = Vec::new();
    for y in first(top, height)..first(bottom, height) {
        let center = y as f64 + 0.5;
        let next = polygon.iter().cycle().skip(1);
        let crossed = polygon
            .iter()
            .zip(next)
            .filter(|(a, b)| (a[1] <= center) != (b[1] <= center));
        crossings.clear();
        crossings
            .extend(crossed.map(|(a, b)| a[0] + (center - a[1]) / (b[1] - a[1]) * (b[0] - a[0])));
        crossings.sort_unstable_by(f64::total_cmp);
        for inside in crossings.chunks_exact(2) {
            run(y, first(inside[0], width)..first(inside[1], width));
        }
    }
}

/// An ellipse with these radii as a polygon.
pub(super) fn ellipse(center: Point, [across, down]: [f64; 2]) -> Vec<Point> {
    let corner = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / CORNERS as f64).sin_cos();
        [center[0] + across * cos, center[1] + down * sin]
    };
    (0..CORNERS).map(corner).collect()
}

/// A rectangle between two opposite corners as a polygon.
pub(super) fn rectangle(a: Point, b: Point) -> Vec<Point> {
    vec![a, [b[0], a[1]], b, [a[0], b[1]]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Whether the ray from `point` to the left crosses the outline an odd number of times.
    fn is_inside(polygon: &[Point], [x, y]: Point) -> bool {
        let mut inside = false;
        for i in 0..polygon.len() {
            let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            let (low, high) = if a[1] < b[1] { (a, b) } else { (b, a) };
            // To the right of the edge, by the sign of the area of the triangle.
            let area = (high[0] - low[0]) * (y - low[1]) - (high[1] - low[1]) * (x - low[0]);
            if low[1] <= y && y < high[1] && area < 0.0 {
                inside = !inside;
            }
        }
        inside
    }

    fn filled(polygon: &[Point], size: (usize, usize)) -> Vec<bool> {
        let mut pixels = vec![false; size.0 * size.1];
        fill(polygon, size, |y, run| {
            pixels[y * size.0..][run].fill(true);
        });
        pixels
    }

    proptest! {
        #[test]
        fn filled_pixels_are_those_with_their_centre_inside(
            polygon in prop::collection::vec([-9.0..40.0_f64, -9.0..40.0], 3..20),
        ) {
            let size = (31, 23);
            for (pixel, found) in filled(&polygon, size).into_iter().enumerate() {
                let center = [(pixel % 31) as f64 + 0.5, (pixel / 31) as f64 + 0.5];
                prop_assert_eq!(found, is_inside(&polygon, center), "{:?}", center);
            }
        }

        #[test]
        fn the_area_is_that_of_the_polygon(
            radii in prop::collection::vec(20.0..90.0_f64, 3..30),
        ) {
            // Around a centre, so that it does not cross itself.
            let n = radii.len();
            let point = |(i, r): (usize, &f64)| {
                let angle = std::f64::consts::TAU * i as f64 / n as f64;
                [100.0 + r * angle.cos(), 100.0 + r * angle.sin()]
            };
            let polygon: Vec<Point> = radii.iter().enumerate().map(point).collect();
            let edges = || (0..n).map(|i| (polygon[i], polygon[(i + 1) % n]));
            let area = 0.5 * edges().map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>();
            let rim: f64 = edges().map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
            let pixels = filled(&polygon, (200, 200)).into_iter().filter(|&p| p).count() as f64;
            prop_assert!((pixels - area).abs() < 0.5 * rim, "{} of {}", pixels, area);
        }
    }
}
