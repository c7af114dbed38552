//! COLMAP folders: a sparse model (cameras, images, points3D as `.bin` or `.txt`) beside the photos.
//!
//! Formats: <https://colmap.github.io/format.html>. Poses are world-to-camera in OpenCV axes, pixel centres lie at
//! +0.5: ours.

mod binary;
mod cameras;
mod model;
mod text;

use super::frame::{Frame, joined_name};
use super::listing::{Cloud, LabelFolder, Listing, Problems, read_classes};
use crate::config::Layout;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::mask_file::Masks;
use crate::data::labels::raw;
use crate::data::labels::raw::RawLabels;
use crate::data::options::LoadOptions;
use crate::data::{Limits, Points};
use crate::error::{Error, Result};
use crate::splat::camera::{Camera, Intrinsics};
use cameras::ModelCamera;
use glam::{DMat3, DQuat, DVec3};
use model::{ModelFile, SparseModel, unplaced};
use std::collections::{BTreeMap, HashMap};
use std::path::{Component, Path};

pub(crate) use self::model::found;

/// What to do with a file that is damaged.
const AGAIN: &str = "copy the model again, or write it again with `colmap model_converter`";

/// A registered image as the model has it.
#[derive(Clone, Debug, PartialEq)]
struct PosedImage {
    /// Path below the folder of photos, with `/`.
    name: String,
    /// World-to-camera, w x y z.
    rotation: [f64; 4],
    /// World-to-camera.
    translation: [f64; 3],
    camera: u32,
    /// Where it stands in the file, for messages.
    place: String,
}

/// A point of `points3D`.
#[derive(Clone, Debug, PartialEq)]
struct ModelPoint {
    position: [f64; 3],
    color: [u8; 3],
}

/// Takes points one by one, each with where it stands in the file.
type TakePoint<'t> = dyn FnMut(&dyn Fn() -> String, ModelPoint) -> Result<()> + 't;

/// Refuses a folder without a whole model or without the folder of photos.
pub(crate) fn expect(dir: &Path, options: &LoadOptions) -> Result<()> {
    SparseModel::expect(dir)?;
    if dir.join(&options.images).is_dir() {
        return Ok(());
    }
    let entries = std::fs::read_dir(dir)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.path().is_dir());
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut others: Vec<String> = names.filter(|name| name.starts_with("images")).collect();
    others.sort_unstable();
    let (found, help) = match &others[..] {
        [] => (
            "no such folder".to_owned(),
            "put the photos there, or name their folder with data.images".to_owned(),
        ),
        [first, ..] => (
            format!("no such folder, but {}", others.join(", ")),
            format!("name one with --set data.images={first}"),
        ),
    };
    Err(Error::input(
        dir,
        &options.images,
        found,
        "the folder of the photos that the model was made from",
        help,
    ))
}

/// What the folder says.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let limits = &options.limits;
    let SparseModel {
        folder,
        cameras: cameras_file,
        images: images_file,
        passed_over,
    } = SparseModel::find(dir, limits)?;
    let cameras = match &cameras_file {
        ModelFile::Binary(path) => binary::cameras(path)?,
        ModelFile::Text(path) => text::cameras(path)?,
    };
    let mut images = images_file.images(limits)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));

    let kept = options.pick(&vec![None; images.len()]);
    let cameras: BTreeMap<u32, ModelCamera> = cameras.into_iter().map(|c| (c.id, c)).collect();
    let truth = LabelFolder::optional(dir, "labels");
    let raw_folder = LabelFolder::raw(dir, options.raw_labels.as_deref());
    let instances = LabelFolder::optional(dir, "instances");
    let masks = Masks::of(dir, options, Layout::Colmap, problems);
    let mut names = HashMap::new();
    let mut frames = Vec::with_capacity(kept.len());
    for (i, split) in kept {
        let image = &images[i];
        let name = image.view_name();
        let posed = images_file.path();
        if let Some(first) = names.insert(name.clone(), &image.place) {
            let expected =
                "an image once: views and outputs are named by their path without extension";
            let found = format!("{}, which {first} has too", image.name);
            problems.push(Error::input(
                posed,
                &image.place,
                found,
                expected,
                "drop the repeated image from the model",
            ));
            continue;
        }
        let camera = image.camera(posed, cameras_file.path(), &cameras);
        let Some((camera, lens)) = problems.keep(camera) else {
            continue;
        };
        let below = Path::new(&image.name);
        frames.push(Frame {
            name,
            split,
            image: dir.join(&options.images).join(below),
            present: true,
            camera,
            posed: true,
            lens,
            scales: options.images != "images",
            mask: masks.of_photo(below),
            truth: truth.of(below),
            raw: raw_folder.of(below),
            instances: instances.of(below),
        });
    }
    let labelled = raw::need_table(dir, options, &frames);
    let points = ModelFile::find(&folder, "points3D");
    let mut notices: Vec<String> = passed_over.into_iter().collect();
    // The scene folder itself has other pictures too.
    if Path::new(&options.images)
        .components()
        .any(|part| matches!(part, Component::Normal(_)))
    {
        notices.extend(unplaced(&dir.join(&options.images), &images));
    }
    if points.is_none() {
        notices.push(format!(
            "no points3D in {}: Gaussians start from random points",
            folder.display()
        ));
    }
    let missing = frames.iter().filter(|f| f.truth.is_none()).count();
    if missing > 0 && missing < frames.len() {
        notices.push(format!(
            "{missing} of {} photos have no labels",
            frames.len()
        ));
    }
    Ok(Listing {
        layout: Layout::Colmap,
        file: images_file.path().to_owned(),
        frames,
        classes: problems
            .keep(read_classes(dir, labelled))
            .unwrap_or_default(),
        occurring_classes: false,
        truth_ids: None,
        raw: RawLabels::grey(),
        geometries: MapGeometries::default(),
        resample_labels: false,
        cloud: points.map_or(Cloud::None, |file| Cloud::Colmap(file.path().to_owned())),
        z_up: false,
        notices,
    })
}

/// Reads `points3D`, relative to `origin`; colours are sRGB.
pub(crate) fn read_points(path: &Path, origin: DVec3, limits: &Limits) -> Result<Points> {
    let mut points = Points::default();
    let mut take = |place: &dyn Fn() -> String, point: ModelPoint| {
        let position = (DVec3::from(point.position) - origin)
            .to_array()
            .map(|v| v as f32);
        if let Some(axis) = position.iter().position(|v| !v.is_finite()) {
            let field = format!("{}: {}", place(), ["x", "y", "z"][axis]);
            let found = point.position[axis].to_string();
            return Err(Error::input(
                path,
                field,
                found,
                "a finite number (f32)",
                "remove this point",
            ));
        }
        points.positions.push(position);
        points
            .colors
            .push(point.color.map(|c| f32::from(c) / 255.0));
        Limits::check(
            format!("{}: points", path.display()),
            points.len() as u64,
            limits.points,
            "thin the cloud out",
        )
    };
    match path.extension().is_some_and(|e| e == "bin") {
        true => binary::points(path, limits, &mut take)?,
        false => text::points(path, &mut take)?,
    }
    Ok(points)
}

impl PosedImage {
    /// Its path without extension, folders joined by `_`: unique where photos of several cameras have the same file
    /// names.
    fn view_name(&self) -> String {
        joined_name(Path::new(&self.name))
    }

    /// The camera in world units, and its lens. `posed` and `calibrated` are the two files, for messages.
    fn camera(
        &self,
        posed: &Path,
        calibrated: &Path,
        cameras: &BTreeMap<u32, ModelCamera>,
    ) -> Result<(Camera, crate::data::photos::lens::Lens)> {
        let error = |field: &str, found: String, expected: &str, help: &str| {
            Err(Error::input(
                posed,
                format!("{} ({}): {field}", self.place, self.name),
                found,
                expected,
                help,
            ))
        };
        if self.view_name().is_empty()
            || Path::new(&self.name)
                .components()
                .any(|c| !matches!(c, Component::Normal(_) | Component::CurDir))
        {
            return error(
                "NAME",
                format!("{:?}", self.name),
                "a path below the folder of photos",
                "write the model with relative names",
            );
        }
        let Some(model) = cameras.get(&self.camera) else {
            let expected = format!(
                "one of the {} cameras of {}",
                cameras.len(),
                calibrated.display()
            );
            return error(
                "CAMERA_ID",
                self.camera.to_string(),
                &expected,
                "copy cameras and images of the same model",
            );
        };
        let [w, x, y, z] = self.rotation;
        let norm = self.rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
        // Text files round; anything farther off is no rotation.
        if (norm - 1.0).abs().partial_cmp(&0.01) != Some(std::cmp::Ordering::Less) {
            let found = format!("{:?} of length {norm:.4}", self.rotation);
            return error("QW QX QY QZ", found, "a quaternion of length 1", AGAIN);
        }
        let translation = DVec3::from(self.translation);
        if self.translation.iter().any(|&v| !(v as f32).is_finite()) {
            return error(
                "TX TY TZ",
                format!("{:?}", self.translation),
                "finite numbers (f32)",
                AGAIN,
            );
        }
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let (
            Intrinsics {
                fx,
                fy,
                cx,
                cy,
                width,
                height,
            },
            lens,
        ) = model.checked(calibrated)?;
        let center = -(rotation.transpose() * translation);
        Ok((
            Camera {
                rotation,
                center,
                fx,
                fy,
                cx,
                cy,
                width,
                height,
            },
            lens,
        ))
    }
}
