//! Scores of raw labels: class probabilities for each pixel, as a segmenter gave them.

mod file;

pub use self::file::{ScoreGrid, ScoreMap};

use crate::data::Classes;
use crate::data::bilinear::beside;
use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::Undistortion;
use crate::error::{Result, ensure, invalid};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Folder beside the maps that holds the scores.
const FOLDER: &str = "scores";
/// Extension of their files.
const EXTENSION: &str = "scores";

/// The file with the scores of a label map: `scores/NAME.scores` beside `NAME.png`.
pub fn path_of(map: &Path) -> Option<PathBuf> {
    let name = name_of(&map.file_stem()?.to_string_lossy());
    Some(map.parent()?.join(name))
}

/// The path within the folder of the maps of the scores of `NAME.png`.
pub(crate) fn name_of(name: &str) -> String {
    format!("{FOLDER}/{name}.{EXTENSION}")
}

/// What ids in files of scores mean.
#[derive(Debug)]
pub(crate) struct ScoreIds {
    /// Class id of the scene for each known id; `None` for ids that are left out.
    known: HashMap<u16, Option<u16>>,
    /// Classes that scores may name.
    classes: usize,
}

impl ScoreIds {
    /// For classes with these ids, each with its class id of the scene if it has one there. Probabilities of the id `ignored` are
    /// left out.
    pub fn new(ignored: u16, classes: impl IntoIterator<Item = (u16, Option<u16>)>) -> Self {
        let mut known: HashMap<u16, Option<u16>> = classes.into_iter().collect();
        known.remove(&ignored);
        let classes = known.len();
        known.insert(ignored, None);
        Self { known, classes }
    }
}

/// The scores of a view's raw labels, in their file.
#[derive(Clone, Debug)]
pub struct ViewScores {
    pub(crate) file: PathBuf,
    /// The label map beside it.
    pub(crate) map: PathBuf,
    pub(crate) ids: Arc<ScoreIds>,
    pub(crate) placement: Placement,
}

/// How a view lies on its photo.
#[derive(Clone, Debug)]
pub(crate) struct Placement {
    /// Pixels across and down of the view.
    pub view: [usize; 2],
    /// Pixels across and down of its photo as stored.
    pub photo: [usize; 2],
    /// From the photo to the view, where the lens distorts and the scores are of the distorted photo.
    pub undistortion: Option<Arc<Undistortion>>,
}

impl Placement {
    /// Where a point of the view lies on the photo, as shares of its width and height.
    fn shares(&self, x: f64, y: f64) -> [f64; 2] {
        let [width, height] = self.photo.map(|n| n as f64);
        let mut x = x / self.view[0] as f64 * width;
        let mut y = y / self.view[1] as f64 * height;
        if let Some(undistortion) = &self.undistortion {
            (x, y) = undistortion.source(x, y);
        }
        [x / width, y / height]
    }
}

impl ViewScores {
    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Reads the file. Classes that are not in `classes`, the table of the scene, are left out.
    ///
    /// # Errors
    /// As [`ScoreMap::read`]; [`crate::Error::Input`] for ids that the class table of the maps does not have, and for scores of a
    /// photo of another size.
    pub fn read(&self, classes: &Classes) -> Result<LabelProbabilities> {
        let map = ScoreMap::read(&self.file)?;
        self.check_photo(&map.grid)?;
        let indices = self.indices(&map, classes)?;
        Ok(LabelProbabilities {
            map,
            indices,
            placement: self.placement.clone(),
        })
    }

    /// Class index of each of the map's ids.
    fn indices(&self, map: &ScoreMap, classes: &Classes) -> Result<Vec<Option<u16>>> {
        let index = |(id, probability): (&u16, &u8)| {
            if *probability == 0 {
                return Ok(None); // Ids of probability 0 mean nothing.
            }
            let known = self.ids.known.get(id).ok_or_else(|| {
                invalid!(&self.file, "tensor ids"; found "class id {id}";
                    expected "an id of the {} classes of the label maps", self.ids.classes;
                    help "run `coseg label` again, which keeps the maps, or delete the scores of a map that has other classes")
            })?;
            Ok(known
                .and_then(|id| classes.index(id))
                .map(|index| index as u16))
        };
        map.ids.iter().zip(&map.probabilities).map(index).collect()
    }

    /// Refuses scores of a photo of another size, except those of a scaled copy beside the label map of that copy.
    fn check_photo(&self, grid: &ScoreGrid) -> Result<()> {
        let expected = self.placement.photo;
        if grid.photo == expected {
            return Ok(());
        }
        let (width, height) = ImageFile::open(&self.map)?.size;
        ensure!(grid.photo == [width, height], &self.file, "grid"; found "scores of a photo of {}x{}", grid.photo[0], grid.photo[1];
            expected "{}x{}, the size of its photo", expected[0], expected[1];
            help "run `coseg label` on these photos, or delete the file");
        Ok(())
    }
}

/// The scores of a view's raw labels in memory: class probabilities of any of its pixels.
#[derive(Clone, Debug)]
pub struct LabelProbabilities {
    map: ScoreMap,
    /// Class index of each of the map's ids; `None` where it is not a class of the scene.
    indices: Vec<Option<u16>>,
    placement: Placement,
}

impl LabelProbabilities {
    /// Class probabilities at the centre of the pixel in column `x`, row `y` of the view, as (class index, probability). They are
    /// those of the classes in the four cells around it, the most probable first, and sum to 1. They are bilinear on the grid, then
    /// renormalised. Empty where no class of the scene is known. `found` is emptied first.
    pub fn at(&self, x: usize, y: usize, found: &mut Vec<(u16, f32)>) {
        found.clear();
        let shares = self.placement.shares(x as f64 + 0.5, y as f64 + 0.5);
        let grid = &self.map.grid;
        let axis = |a: usize, cells: usize| {
            let place = grid.scale[a] * shares[a] * grid.photo[a] as f64 + grid.offset[a];
            let (first, second, share) = beside(place, cells);
            [(first, 1.0 - share as f32), (second, share as f32)]
        };
        for (row, wy) in axis(1, self.map.height) {
            for (column, wx) in axis(0, self.map.width) {
                if wx * wy > 0.0 {
                    self.add_cell(row * self.map.width + column, wx * wy, found);
                }
            }
        }
        let sum: f32 = found.iter().map(|(_, p)| p).sum();
        found.iter_mut().for_each(|(_, p)| *p /= sum);
        found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    }

    /// Adds the probabilities of a cell, times `weight`.
    fn add_cell(&self, cell: usize, weight: f32, found: &mut Vec<(u16, f32)>) {
        let cells = self.map.width * self.map.height;
        for n in 0..self.map.classes {
            let Some(class) = self.indices[n * cells + cell] else {
                continue;
            };
            let share = weight * f32::from(self.map.probabilities[n * cells + cell]) / 255.0;
            if share == 0.0 {
                continue; // Ids of probability 0 mean nothing.
            }
            match found.iter_mut().find(|(other, _)| *other == class) {
                Some((_, sum)) => *sum += share,
                None => found.push((class, share)),
            }
        }
    }

    /// Pixels across and down of the view.
    pub fn size(&self) -> [usize; 2] {
        self.placement.view
    }

    /// The stored scores, in ids of the file.
    pub fn map(&self) -> &ScoreMap {
        &self.map
    }
}
