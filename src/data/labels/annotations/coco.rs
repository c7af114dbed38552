//! COCO instances with run lengths: one annotation for each label of each image.
//!
//! Format: <https://cocodataset.org/#format-data>, 'Object Detection'. The key `label` of an annotation is the label id, which an
//! object keeps in all images.

use super::Categories;
use crate::data::LabelMap;
use crate::error::Result;
use crate::files::atomic;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The content of such a file.
#[derive(Clone, Debug, Serialize)]
pub struct CocoInstances {
    images: Vec<Value>,
    annotations: Vec<Annotation>,
    categories: Vec<Value>,
    #[serde(skip)]
    of_labels: BTreeMap<u16, u16>,
}

#[derive(Clone, Debug, Serialize)]
struct Annotation {
    id: usize,
    image_id: usize,
    category_id: u16,
    label: u16,
    iscrowd: u8,
    area: usize,
    /// Left, top, width, height.
    bbox: [usize; 4],
    segmentation: Runs,
}

#[derive(Clone, Debug, Serialize)]
struct Runs {
    /// Height and width.
    size: [usize; 2],
    /// Pixels outside and inside in turns, down the columns.
    counts: Vec<usize>,
}

/// Where a label is.
struct Region {
    counts: Vec<usize>,
    /// The pixel after the last run.
    end: usize,
    low: [usize; 2],
    high: [usize; 2],
}

impl CocoInstances {
    /// A file without images.
    pub fn new(categories: &Categories) -> Self {
        let category = |(id, name): (&u16, &String)| json!({ "id": id, "name": name });
        Self {
            images: Vec::new(),
            annotations: Vec::new(),
            categories: categories.names.iter().map(category).collect(),
            of_labels: categories.of_labels.clone(),
        }
    }

    /// Adds an image and its labels. Labels without a category are left out.
    pub fn add(&mut self, file_name: String, map: &LabelMap) {
        let &LabelMap { width, height, .. } = map;
        let image_id = self.images.len() + 1;
        self.images.push(
            json!({ "id": image_id, "file_name": file_name, "width": width, "height": height }),
        );
        for (label, region) in regions(map) {
            let Some(&category_id) = self.of_labels.get(&label) else {
                continue;
            };
            let (low, high) = (region.low, region.high);
            let mut counts = region.counts;
            let area = counts.iter().skip(1).step_by(2).sum();
            counts.push(width * height - region.end);
            self.annotations.push(Annotation {
                id: self.annotations.len() + 1,
                image_id,
                category_id,
                label,
                iscrowd: 0,
                area,
                bbox: [low[0], low[1], high[0] - low[0] + 1, high[1] - low[1] + 1],
                segmentation: Runs {
                    size: [height, width],
                    counts,
                },
            });
        }
    }

    /// Writes the file.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        atomic::write(path, |out| Ok(serde_json::to_writer(out, self)?))
    }
}

/// The pixels of each label.
fn regions(map: &LabelMap) -> BTreeMap<u16, Region> {
    let mut regions: BTreeMap<u16, Region> = BTreeMap::new();
    for x in 0..map.width {
        for y in 0..map.height {
            let at = x * map.height + y;
            let region = regions.entry(map.ids[y * map.width + x]).or_insert(Region {
                counts: Vec::new(),
                end: 0,
                low: [x, y],
                high: [x, y],
            });
            match region.counts.last_mut() {
                Some(run) if region.end == at => *run += 1,
                _ => region.counts.extend([at - region.end, 1]),
            }
            region.end = at + 1;
            for (axis, v) in [x, y].into_iter().enumerate() {
                region.low[axis] = region.low[axis].min(v);
                region.high[axis] = region.high[axis].max(v);
            }
        }
    }
    regions
}
