//! One posed photo of a scene folder, and the camera that its pixels are of.

use crate::data::photos::image_file::ImageFile;
use crate::data::photos::lens::{Lens, Remap};
use crate::data::photos::photo::Development;
use crate::data::{LabelMap, Limits, MapGeometry, Split};
use crate::error::{Error, Result};
use crate::splat::camera::Camera;
use image::RgbImage;
use std::path::{Component, Path, PathBuf};

/// How far the proportions of a label map may be from those of its photo when it is resampled: ScanNet's own sizes,
/// 1296x968 and 640x480, differ by 0.4 %.
const PROPORTION: f64 = 0.02;

/// One posed photo.
pub(crate) struct Frame {
    pub name: String,
    pub split: Split,
    pub image: PathBuf,
    /// `false` where the photo is known to be missing, which was told.
    pub present: bool,
    /// Pose and intrinsics of the photo as it lies there, in world units.
    pub camera: Camera,
    /// `false` where the pose or the intrinsics cannot be read, which was told.
    pub posed: bool,
    pub lens: Lens,
    /// A photo of another size is taken, and the camera scaled to it.
    pub scales: bool,
    /// Which pixels count; all of them without one.
    pub mask: Option<PathBuf>,
    pub truth: Option<PathBuf>,
    /// Raw labels: a map, or a folder of masks.
    pub raw: Option<PathBuf>,
    /// True instance ids.
    pub instances: Option<PathBuf>,
}

/// The camera of a view and how its photo becomes a pinhole's.
pub(crate) struct Geometry {
    /// Undistorted, in world units, of the size of the photo's file.
    pub camera: Camera,
    development: Development,
}

impl Frame {
    /// Reads the photo's file, not yet decoded, and settles the camera.
    pub fn open(&self, file: &Path, limits: &Limits) -> Result<(ImageFile, Geometry)> {
        if !self.image.is_file() {
            let help = "put the image there or drop the frame".into();
            return Err(Error::Missing {
                what: "file",
                path: self.image.clone(),
                help,
            });
        }
        let image = ImageFile::open(&self.image, limits)?;
        let (w, h) = (self.camera.width, self.camera.height);
        let geometry = match self.scales && proportional(image.size, (w, h)) {
            true => self.geometry(image.size)?,
            false => {
                image.expect_size(w, h, &format!("{} says", file.display()))?;
                self.geometry((w, h))?
            }
        };
        Ok((image, geometry))
    }

    /// The camera for a photo of this size.
    pub fn geometry(&self, (width, height): (usize, usize)) -> Result<Geometry> {
        let camera = self.camera.resized(width, height);
        if self.lens.is_pinhole() {
            return Ok(Geometry {
                camera,
                development: Development::default(),
            });
        }
        let Some(remap) = Remap::new(&camera, self.lens) else {
            let found = format!("radial {:?}, tangential {:?}", self.lens.k, self.lens.p);
            let expected = "a distortion that does not fold the image over";
            let help = "calibrate again, or undistort the photos with the tool that made the poses";
            return Err(Error::input(
                &self.image,
                "lens distortion",
                found,
                expected,
                help,
            ));
        };
        let camera = remap.pinhole.clone();
        Ok(Geometry {
            camera,
            development: Development {
                remap: Some(remap),
                ..Development::default()
            },
        })
    }

    /// Whether it has labels or a mask, and its photo, in `file`, may have been turned for them without that a size tells.
    pub fn is_turned_unseen(&self, file: &ImageFile) -> bool {
        let maps = [&self.truth, &self.raw, &self.instances, &self.mask];
        maps.into_iter().any(Option::is_some) && file.turns_unseen()
    }
}

/// A photo's path without its extension, folders joined by `_`: what names its view where photos of several folders have the same
/// file names.
pub(crate) fn joined_name(photo: &Path) -> String {
    let path = photo.with_extension("");
    let parts = path.components().filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy()),
        _ => None,
    });
    parts.collect::<Vec<_>>().join("_")
}

/// Whether two sizes have the same proportions, as far as [`PROPORTION`] asks.
pub(crate) fn proportional((w, h): (usize, usize), (width, height): (usize, usize)) -> bool {
    let ratio = (w as f64 / h as f64) / (width as f64 / height as f64);
    (ratio - 1.0).abs() < PROPORTION
}

/// The size to which a photo is reduced so that no side is longer than `most` pixels; none where none is, or `most` is 0.
pub(crate) fn reduced((width, height): (usize, usize), most: usize) -> Option<(usize, usize)> {
    let longer = width.max(height);
    let side = |length: usize| ((length * most) as f64 / longer as f64).round().max(1.0) as usize;
    (most > 0 && longer > most).then(|| (side(width), side(height)))
}

impl Geometry {
    /// The same with no side longer than `most` pixels; 0 is no limit.
    pub fn within(mut self, most: usize) -> Self {
        self.development.size = reduced((self.camera.width, self.camera.height), most);
        self
    }

    /// The camera of the photo as it is used.
    pub fn seen(&self) -> Camera {
        self.development.size.map_or_else(
            || self.camera.clone(),
            |(width, height)| self.camera.resized(width, height),
        )
    }

    /// How the photo's file becomes what is used.
    pub fn development(&self) -> Development {
        self.development.clone()
    }

    /// The photo as it is used.
    pub fn photo(&self, file: &ImageFile) -> Result<RgbImage> {
        Ok(self.development.decode(file)?.0)
    }

    /// Whether a picture of this size is one of the reduced photo, as maps that were made of the scene are where nothing says
    /// what they are of.
    pub fn is_as_seen(&self, size: (usize, usize)) -> bool {
        self.development.size == Some(size)
    }

    /// A label map, in any size, as the camera sees it. Where nothing is `said` of what it is of, one of the size of the
    /// reduced photo was made of the scene.
    pub fn labels(&self, map: LabelMap, said: Option<MapGeometry>) -> LabelMap {
        match said {
            Some(MapGeometry::Undistorted) => self.resized(map),
            None if self.is_as_seen((map.width, map.height)) => map,
            None | Some(MapGeometry::Photos) => self.labels_of_photo(map),
        }
    }

    /// A map of the photo as it lies there, in any size, as the camera sees it.
    pub fn labels_of_photo(&self, map: LabelMap) -> LabelMap {
        let map = match &self.development.remap {
            Some(remap) => remap.labels(&map),
            None => map,
        };
        self.resized(map)
    }

    fn resized(&self, map: LabelMap) -> LabelMap {
        let Camera { width, height, .. } = self.seen();
        map.resized(width, height)
    }
}
