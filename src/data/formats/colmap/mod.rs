//! COLMAP folders: a sparse model (cameras, images, points3D as `.bin` or `.txt`) beside the photos.
//!
//! Formats: <https://colmap.github.io/format.html>. Poses are world-to-camera in OpenCV axes, and pixel centres lie at
//! +0.5, as in this crate.

mod cameras;
mod images;
mod model;
mod reader;

use super::folder::{Folder, Problems};
use super::frame::{Frame, below};
use super::listing::{Cloud, Listing};
use super::side_folders::SideFolders;
use crate::data::Points;
use crate::data::options::LoadOptions;
use crate::error::{Result, bail, invalid};
use crate::files::{check_points, names};
use glam::DVec3;
use model::SparseModel;
use reader::Reader;
use std::collections::HashMap;
use std::path::Path;

pub(crate) use self::model::marker;

/// What to do with a file that is damaged.
const DAMAGED_HELP: &str = "copy the model again, or write it again with `colmap model_converter`";

/// Refuses a folder without a whole model or without the folder of photos.
pub(crate) fn expect(dir: &Path, options: &LoadOptions) -> Result<()> {
    SparseModel::expect(dir)?;
    let images = &options.images;
    if dir.join(images).is_dir() {
        return Ok(());
    }
    let others = names(dir, |name, path| {
        name.starts_with("images") && path.is_dir()
    });
    let expected = "the folder of the photos that the model was made from";
    Err(match others.first() {
        None => invalid!(dir, "{images}"; found "no such folder"; expected "{expected}";
            help "put the photos there, or name their folder with data.images"),
        Some(first) => invalid!(dir, "{images}"; found "no such folder, but {}", others.join(", ");
            expected "{expected}"; help "name one with --set data.images={first}"),
    })
}

/// Lists the frames of the folder.
pub(crate) fn list(folder: Folder<'_>, problems: &mut Problems) -> Result<Listing> {
    let Folder { dir, options, .. } = folder;
    let model = SparseModel::find(dir)?;
    let cameras = cameras::read(&model.cameras)?;
    let mut images = images::read(&model.images)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let folders = SideFolders::new(folder, problems);
    let mut first = HashMap::new();
    let mut frames = Vec::new();
    for (i, split) in options.pick(&vec![None; images.len()]) {
        let image = &images[i];
        let name = image.view_name();
        if let Some(earlier) = first.insert(name.clone(), &image.place) {
            problems.push(invalid!(&model.images, "{}", image.place; found "{}, which {earlier} has too", image.name;
                expected "an image once: views and outputs are named by their path without extension";
                help "drop the repeated image from the model"));
            continue;
        }
        let camera = image.camera(&model.images, &model.cameras, &cameras);
        let Some((camera, lens)) = problems.ok(camera) else {
            continue;
        };
        let photo = Path::new(&image.name);
        let frame = Frame::new(name, split, dir.join(&options.images).join(photo), camera);
        frames.push(Frame {
            lens,
            resizable: options.images != "images",
            ..folders.frame(frame, photo)
        });
    }
    let points = model::find(&model.folder, "points3D");
    let mut notices: Vec<String> = model.others.into_iter().collect();
    // Where the photos lie in the scene folder itself, it has other pictures too.
    if below(Path::new(&options.images)) != Path::new("") {
        notices.extend(model::unplaced(&dir.join(&options.images), &images));
    }
    if points.is_none() {
        let model = model.folder.display();
        notices.push(format!(
            "no points3D in {model}: Gaussians start from random points"
        ));
    }
    Ok(Listing {
        cloud: points.map_or(Cloud::None, Cloud::Colmap),
        notices,
        ..Listing::new(folder, model.images, frames, None, problems)
    })
}

/// Reads `points3D`, relative to `origin`; colours are sRGB.
pub(crate) fn read_points(path: &Path, origin: DVec3) -> Result<Points> {
    let mut reader = Reader::open(path, "point", 8 + 24 + 3 + 8 + 8)?;
    check_points(path, reader.count().unwrap_or(0))?;
    let mut points = Points::default();
    while reader.next()? {
        reader.value::<u64>("POINT3D_ID")?;
        let position: [f64; 3] = reader.values("X Y Z")?;
        let color: [u8; 3] = reader.values("R G B")?;
        reader.value::<f64>("ERROR")?;
        let relative = (DVec3::from(position) - origin)
            .to_array()
            .map(|v| v as f32);
        if let Some(axis) = relative.iter().position(|v| !v.is_finite()) {
            bail!(path, "{}: {}", reader.place(), ["x", "y", "z"][axis]; found "{}", position[axis];
                expected "a finite number (f32)"; help "remove this point");
        }
        reader.skip_list(8, "TRACK", false)?;
        points.positions.push(relative);
        points.colors.push(color.map(|c| f32::from(c) / 255.0));
        check_points(path, points.len() as u64)?;
    }
    Ok(points)
}
