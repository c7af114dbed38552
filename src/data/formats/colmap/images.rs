//! The posed images of a model.

use super::DAMAGED_HELP;
use super::cameras::Cameras;
use super::reader::Reader;
use crate::data::formats::camera_checks::{is_coordinate, posed};
use crate::data::formats::frame::joined_name;
use crate::data::photos::lens::Lens;
use crate::error::{Result, ensure, invalid};
use crate::files::{MAX_VIEWS, check_limit};
use crate::splat::camera::Camera;
use glam::{DMat3, DMat4, DQuat, DVec3};
use std::path::{Component, Path};

/// Bytes of the smallest image and of each observation in a binary file.
const MIN_IMAGE_BYTES: u64 = 4 + 7 * 8 + 4 + 2 + 8;
const OBSERVATION_BYTES: u64 = 24;

/// A registered image as the model has it.
#[derive(Debug, PartialEq)]
pub(super) struct PosedImage {
    /// Path below the folder of photos, with `/`.
    pub name: String,
    /// World-to-camera, w x y z.
    rotation: [f64; 4],
    /// World-to-camera.
    translation: [f64; 3],
    camera: u32,
    /// Where it stands in the file, for messages.
    pub place: String,
}

/// How many images the model has.
pub(super) fn count(path: &Path) -> Result<u64> {
    match Reader::open(path, "image", MIN_IMAGE_BYTES)?.count() {
        Some(count) => Ok(count),
        None => Ok(read(path)?.len() as u64),
    }
}

/// Reads `images.bin` or `images.txt`.
pub(super) fn read(path: &Path) -> Result<Vec<PosedImage>> {
    let mut reader = Reader::open(path, "image", MIN_IMAGE_BYTES)?;
    // A model may have more images than a scene: they are thinned out later.
    let most = 64 * MAX_VIEWS;
    let count = reader.count().unwrap_or(0);
    check_limit(path, "images", count, most, "split the model")?;
    let mut images = Vec::new();
    while reader.next()? {
        let place = reader.place();
        reader.value::<u32>("IMAGE_ID")?;
        let rotation = reader.values("QW QX QY QZ")?;
        let translation = reader.values("TX TY TZ")?;
        let camera = reader.value("CAMERA_ID")?;
        let name = reader.name()?;
        reader.skip_list(OBSERVATION_BYTES, "POINTS2D", true)?;
        images.push(PosedImage {
            name,
            rotation,
            translation,
            camera,
            place,
        });
    }
    Ok(images)
}

impl PosedImage {
    /// Its path without extension, folders joined by `_`: unique where photos of several cameras have the same file
    /// names.
    pub fn view_name(&self) -> String {
        joined_name(Path::new(&self.name))
    }

    /// The camera in world units, and its lens. `images` and `calibration` are the two files, for messages.
    pub fn camera(
        &self,
        images: &Path,
        calibration: &Path,
        cameras: &Cameras,
    ) -> Result<(Camera, Lens)> {
        let place = format!("{} ({})", self.place, self.name);
        let is_below = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        ensure!(!self.view_name().is_empty() && Path::new(&self.name).components().all(is_below),
            images, "{place}: NAME"; found "{:?}", self.name; expected "a path below the folder of photos";
            help "write the model with relative names");
        let camera = cameras.get(&self.camera).ok_or_else(|| {
            invalid!(images, "{place}: CAMERA_ID"; found "{}", self.camera;
                expected "one of the {} cameras of {}", cameras.len(), calibration.display();
                help "copy cameras and images of the same model")
        })?;
        let [w, x, y, z] = self.rotation;
        let norm = DQuat::from_xyzw(x, y, z, w).length();
        // Text files round; anything farther off is not a rotation.
        ensure!((0.99..1.01).contains(&norm),
            images, "{place}: QW QX QY QZ"; found "{:?} of length {norm:.4}", self.rotation;
            expected "a quaternion of length 1"; help "{DAMAGED_HELP}");
        ensure!(self.translation.iter().all(|&v| is_coordinate(v)),
            images, "{place}: TX TY TZ"; found "{:?}", self.translation; expected "finite numbers (f32)"; help "{DAMAGED_HELP}");
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let center = -(rotation.transpose() * DVec3::from(self.translation));
        let mut pose = DMat4::from_mat3(rotation.transpose());
        pose.w_axis = center.extend(1.0);
        let (intrinsics, lens) = camera.checked(calibration)?;
        let camera = posed(images, &self.place, &pose, |pose| {
            intrinsics.clone().with_opencv_pose(pose)
        })?;
        Ok((camera, lens))
    }
}
