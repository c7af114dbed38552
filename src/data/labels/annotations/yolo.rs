//! YOLO segmentation: a text file for each image, a line for each region: the number of its class, then the corners of its outline,
//! `x y` from 0 to 1. `data.yaml` names the classes and the lists of images.
//!
//! Format: <https://docs.ultralytics.com/datasets/segment>. The labels of `images/NAME.jpg` are in `labels/NAME.txt`. Pixels of a
//! region are connected by their sides. Its outline runs along the sides of its pixels. A hole is joined to it by a cut of zero
//! width, so that the areas are exact.

use super::Categories;
use crate::data::{LabelMap, Split};
use crate::error::{Result, ensure};
use crate::files::{self, atomic, own};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// The lists of images.
const LISTS: [(Split, &str); 2] = [(Split::Train, "train.txt"), (Split::Test, "val.txt")];
/// The file that names classes and lists.
const DATA: &str = "data.yaml";

/// A corner of pixels: columns and rows to its left and above.
type Corner = [usize; 2];

/// Writer of such files.
#[derive(Clone, Debug)]
pub struct Yolo<'a> {
    categories: &'a Categories,
    /// Class numbers by category id.
    numbers: BTreeMap<u16, usize>,
}

impl<'a> Yolo<'a> {
    /// Classes are numbered from 0 on, by their category ids.
    pub fn new(categories: &'a Categories) -> Self {
        let numbers = categories.names.keys().copied().zip(0..).collect();
        Self {
            categories,
            numbers,
        }
    }

    /// Refuses what [`Yolo::write_lists`] could not write in `folder` after frames of the splits `rendered`: over files that this
    /// program did not write, and beside the list of another split, which stays, if its labels have other classes.
    ///
    /// # Errors
    /// [`crate::Error::Argument`]; [`crate::Error::Input`]; [`crate::Error::Io`].
    pub fn check_lists(&self, folder: &Path, rendered: &[Split]) -> Result<()> {
        let data = folder.join(DATA);
        own::check(&data)?;
        for (split, list) in LISTS {
            let path = folder.join(list);
            own::check(&path)?;
            let stays = !rendered.contains(&split) && path.is_file();
            let has_names = || files::text(&data).is_ok_and(|text| text.ends_with(&self.names()));
            ensure!(!stays || has_names(), &data, "names"; found "other classes, which the labels of {list} have";
                expected "the classes of the scene"; help "render both splits again (--split all), or name another folder");
        }
        Ok(())
    }

    /// Writes `data.yaml`, and `train.txt` and `val.txt` with the names of the `images`, which are in the folder `images` beside it. Test
    /// images are those of `val.txt`. Where a split has no image, its list stays as it is. If it has none, the list of the other
    /// stands for it, as trainers want both.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write_lists(&self, folder: &Path, images: &[(Split, String)]) -> Result<()> {
        let mut named = Vec::new();
        for (split, list) in LISTS {
            let path = folder.join(list);
            let of_split = images.iter().filter(|(of, _)| *of == split);
            let lines: String = of_split
                .map(|(_, name)| format!("./images/{name}\n"))
                .collect();
            if !lines.is_empty() {
                atomic::write_bytes(&path, lines.as_bytes())?;
            }
            if path.is_file() {
                named.push(list);
            }
        }
        let [train, val] = [named.first(), named.last()].map(|list| list.unwrap_or(&"train.txt"));
        // Without the key `path`, the lists are looked for beside the file, wherever it is moved.
        let text = format!("train: {train}\nval: {val}\n{}", self.names());
        atomic::write_bytes(folder.join(DATA), text.as_bytes())
    }

    /// The last lines of `data.yaml`.
    fn names(&self) -> String {
        // A string of JSON is one of YAML.
        let quoted = |name: &String| serde_json::Value::from(name.as_str());
        let names = self.categories.names.values().map(quoted).enumerate();
        let lines = names.map(|(number, name)| format!("  {number}: {name}\n"));
        format!("names:\n{}", lines.collect::<String>())
    }

    /// Writes the regions of a map. Labels without a category are left out.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write(&self, path: &Path, map: &LabelMap) -> Result<()> {
        let mut text = String::new();
        for (label, outline) in outlines(map) {
            let category = self.categories.of_labels.get(&label);
            let Some(number) = category.and_then(|id| self.numbers.get(id)) else {
                continue;
            };
            // Writing to a string does not fail.
            let _ = write!(text, "{number}");
            for [x, y] in outline {
                let [x, y] = [x as f64 / map.width as f64, y as f64 / map.height as f64];
                let _ = write!(text, " {x:.6} {y:.6}");
            }
            text.push('\n');
        }
        atomic::write_bytes(path, text.as_bytes())
    }
}

/// Label and outline of each region, in the order of their first pixels.
fn outlines(map: &LabelMap) -> Vec<(u16, Vec<Corner>)> {
    let &LabelMap { width, height, .. } = map;
    let regions = map.region_numbers();
    let mut outlines: Vec<(u16, Vec<Corner>)> = Vec::new();
    let mut seen = vec![false; regions.len()];
    for i in 0..regions.len() {
        let is_top = i < width || regions[i - width] != regions[i];
        if !is_top || seen[i] {
            continue;
        }
        let loops = follow(&regions, [width, height], i, &mut seen);
        match outlines.get_mut(regions[i] as usize) {
            // The first side of a region lies on its outer outline.
            Some((_, outline)) => *outline = joined(outline, &loops),
            None => outlines.push((map.ids[i], loops)),
        }
    }
    outlines
}

/// The corners of the closed line that begins above pixel `first`, with the region to its right. Marks the upper sides that it takes
/// in `seen`.
fn follow(
    regions: &[u32],
    [width, height]: [usize; 2],
    first: usize,
    seen: &mut [bool],
) -> Vec<Corner> {
    // Right, down, left, up; and the pixels ahead of a corner, to the left and to the right of that direction.
    const STEPS: [[isize; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    const AHEAD: [[[isize; 2]; 2]; 4] = [
        [[0, -1], [0, 0]],
        [[0, 0], [-1, 0]],
        [[-1, 0], [-1, -1]],
        [[-1, -1], [0, -1]],
    ];
    let region = regions[first];
    let is_inside = |x: isize, y: isize| {
        let is_pixel = (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
        is_pixel && regions[y as usize * width + x as usize] == region
    };
    let start = [(first % width) as isize, (first / width) as isize];
    let mut at = start;
    let mut direction = 0;
    let mut corners = Vec::new();
    loop {
        if direction == 0 {
            seen[at[1] as usize * width + at[0] as usize] = true;
        }
        let [dx, dy] = STEPS[direction];
        at = [at[0] + dx, at[1] + dy];
        let [left, right] = AHEAD[direction].map(|[dx, dy]| is_inside(at[0] + dx, at[1] + dy));
        let turned = if !right {
            (direction + 1) % 4
        } else if left {
            (direction + 3) % 4
        } else {
            direction
        };
        if turned != direction {
            corners.push([at[0] as usize, at[1] as usize]);
        }
        direction = turned;
        if at == start && direction == 0 {
            return corners;
        }
    }
}

/// The outline with a cut to the first corner of a hole and back, from the nearest corner of the outline. Only that one is searched
/// for: a speckled map has thousands of holes.
fn joined(outline: &[Corner], hole: &[Corner]) -> Vec<Corner> {
    let distance = |a: &Corner| a[0].abs_diff(hole[0][0]) + a[1].abs_diff(hole[0][1]);
    let nearest = (0..outline.len()).min_by_key(|&i| distance(&outline[i]));
    let i = nearest.unwrap_or_default();
    [&outline[..=i], hole, &hole[..1], &outline[i..]].concat()
}
