//! Masks of things: polygons drawn by hand, or instance maps.

use coseg::data::{NamedCamera, Split};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::path::Path;

/// Pixels of a thing in a view where it is clicked or judged, at least.
const LEAST_PIXELS: usize = 400;

/// Where a view shows a thing.
pub struct Mask {
    /// Index of the view.
    pub view: usize,
    /// Of each pixel, row by row.
    pub inside: Vec<bool>,
}

impl Mask {
    /// The pixels inside.
    pub fn pixels(&self) -> Vec<usize> {
        (0..self.inside.len()).filter(|&i| self.inside[i]).collect()
    }
}

/// A thing in the views where it is clicked, two or more, and in those where the selection is judged.
pub struct Thing {
    pub clicked: Vec<Mask>,
    pub judged: Vec<Mask>,
}

#[derive(Deserialize)]
struct Polygons {
    /// Of the image that the corners are in units of.
    size: [f64; 2],
    clicked: BTreeMap<String, Vec<[f64; 2]>>,
    judged: BTreeMap<String, Vec<[f64; 2]>>,
}

/// The things of the JSON file or of the folder of instance maps at `path`.
pub fn read(path: &Path, cameras: &[NamedCamera]) -> Result<Vec<Thing>, Box<dyn Error>> {
    let things = if path.is_dir() {
        instances(path, cameras)?
    } else {
        let polygons: Polygons = serde_json::from_str(&std::fs::read_to_string(path)?)?;
        let masks = |of: &BTreeMap<String, Vec<[f64; 2]>>| {
            of.iter()
                .map(|(name, polygon)| drawn(name, polygon, polygons.size, cameras))
                .collect::<Result<Vec<_>, _>>()
        };
        vec![Thing {
            clicked: masks(&polygons.clicked)?,
            judged: masks(&polygons.judged)?,
        }]
    };
    let is_usable = |thing: &Thing| thing.clicked.len() >= 2 && !thing.judged.is_empty();
    let usable: Vec<Thing> = things.into_iter().filter(is_usable).collect();
    if usable.is_empty() {
        return Err("no thing has masks of two views to click in and one to judge".into());
    }
    Ok(usable)
}

fn drawn(
    name: &str,
    polygon: &[[f64; 2]],
    size: [f64; 2],
    cameras: &[NamedCamera],
) -> Result<Mask, Box<dyn Error>> {
    let view = cameras.iter().position(|camera| camera.name == name);
    let view = view.ok_or_else(|| format!("no frame {name}"))?;
    let camera = &cameras[view].camera;
    let (width, height) = (camera.width, camera.height);
    let scale = [width as f64 / size[0], height as f64 / size[1]];
    let center = |i: usize| [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
    let at = |i| [0, 1].map(|axis| center(i)[axis] / scale[axis]);
    let inside: Vec<bool> = (0..width * height)
        .map(|i| is_inside(at(i), polygon))
        .collect();
    if !inside.contains(&true) {
        return Err(format!("the mask of {name} has no pixels").into());
    }
    Ok(Mask { view, inside })
}

/// Whether a ray from the point to the right crosses the polygon an odd number of times.
fn is_inside([x, y]: [f64; 2], polygon: &[[f64; 2]]) -> bool {
    let next = polygon.iter().cycle().skip(1);
    let crosses = polygon.iter().zip(next).filter(|([ax, ay], [bx, by])| {
        (*ay > y) != (*by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    });
    crosses.count() % 2 == 1
}

/// Things are clicked in training views and judged in held-out ones. Instance 0 is not a thing.
fn instances(folder: &Path, cameras: &[NamedCamera]) -> Result<Vec<Thing>, Box<dyn Error>> {
    let map = |camera: &NamedCamera| -> Result<Vec<u16>, Box<dyn Error>> {
        let file = folder.join(format!("{}.png", camera.name));
        let ids = image::open(&file)?.into_luma16();
        let size = (camera.camera.width as u32, camera.camera.height as u32);
        if ids.dimensions() != size {
            return Err(format!("{}: not the size of the camera", file.display()).into());
        }
        Ok(ids.into_raw())
    };
    let maps = cameras.iter().map(map).collect::<Result<Vec<_>, _>>()?;
    let ids: BTreeSet<u16> = maps
        .iter()
        .flatten()
        .copied()
        .filter(|id| *id > 0)
        .collect();
    let masks = |id: u16, split: Split| {
        let of_split = (0..maps.len()).filter(move |&view| cameras[view].split == split);
        let mask = |view: usize| Mask {
            view,
            inside: maps[view].iter().map(|other| *other == id).collect(),
        };
        let is_large = |mask: &Mask| mask.pixels().len() >= LEAST_PIXELS;
        of_split.map(mask).filter(is_large).collect()
    };
    let thing = |id: u16| Thing {
        clicked: masks(id, Split::Train),
        judged: masks(id, Split::Test),
    };
    Ok(ids.into_iter().map(thing).collect())
}
