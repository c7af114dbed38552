//! One posed photo of a scene folder, and the camera of the view that it becomes.

use crate::data::labels::raw::RawFile;
use crate::data::labels::scores::Placement;
use crate::data::photos::image_file::{ImageFile, proportional};
use crate::data::photos::lens::{Lens, Undistortion};
use crate::data::photos::photo::Preprocessing;
use crate::data::{LabelMap, MapGeometry, Split};
use crate::error::{Result, invalid};
use crate::files::expect_file;
use crate::splat::camera::Camera;
use image::RgbImage;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// One posed photo.
pub(crate) struct Frame {
    pub name: String,
    pub split: Split,
    pub image: PathBuf,
    /// `false` if the photo is missing, which was reported.
    pub present: bool,
    /// Pose and intrinsics of the photo as stored, in world units.
    pub camera: Camera,
    /// `false` if the pose or the intrinsics cannot be read, which was reported.
    pub posed: bool,
    pub lens: Lens,
    /// A photo of another size is accepted, and the camera scaled to it.
    pub resizable: bool,
    /// Mask of the pixels that are used; without one, all are used.
    pub mask: Option<PathBuf>,
    pub truth: Option<PathBuf>,
    /// Raw labels: a map, a folder of masks, or a file of shapes.
    pub raw: Option<PathBuf>,
    /// A JSON file where the raw labels are looked for, named as the photo: LabelMe's, perhaps.
    pub drawn: Option<PathBuf>,
    /// It has a label map that is not read, as files of LabelMe come first.
    pub has_unread_map: bool,
    /// True instance ids.
    pub instances: Option<PathBuf>,
}

/// The camera of a view, and how its photo becomes a pinhole's.
pub(crate) struct Geometry {
    /// Undistorted, in world units, of the size of the photo's file.
    pub camera: Camera,
    /// How the photo's file becomes the view's image.
    pub preprocessing: Preprocessing,
}

impl Frame {
    /// A frame of a pinhole camera without labels.
    pub fn new(name: String, split: Split, image: PathBuf, camera: Camera) -> Self {
        Self {
            name,
            split,
            image,
            present: true,
            camera,
            posed: true,
            lens: Lens::default(),
            resizable: false,
            mask: None,
            truth: None,
            raw: None,
            drawn: None,
            has_unread_map: false,
            instances: None,
        }
    }

    /// Reads the photo's file without decoding it, and gives the camera for its size. `file` lists the frames, for messages.
    pub fn open(&self, file: &Path) -> Result<(ImageFile, Geometry)> {
        expect_file(&self.image, "put the image there or drop the frame")?;
        let image = ImageFile::open(&self.image)?;
        let size = (self.camera.width, self.camera.height);
        if !(self.resizable && proportional(image.size, size)) {
            let help =
                "scale the photo to that size, or correct the size with focal length and centre";
            image.expect_size(size, &format!("{} says", file.display()), help)?;
        }
        let geometry = self.geometry(image.size)?;
        Ok((image, geometry))
    }

    /// The camera for a photo of this size.
    pub fn geometry(&self, (width, height): (usize, usize)) -> Result<Geometry> {
        let mut geometry = Geometry {
            camera: self.camera.resized(width, height),
            preprocessing: Preprocessing::default(),
        };
        if !self.lens.is_pinhole() {
            let undistortion = Undistortion::new(&geometry.camera, self.lens).ok_or_else(|| {
                invalid!(&self.image, "lens distortion"; found "radial {:?}, tangential {:?}", self.lens.k, self.lens.p;
                    expected "a distortion that does not fold the image over";
                    help "calibrate again, or undistort the photos with the tool that made the poses")
            })?;
            geometry.camera = undistortion.pinhole.clone();
            geometry.preprocessing.undistortion = Some(undistortion);
        }
        Ok(geometry)
    }

    /// The camera for the size of the frame's own camera.
    pub fn own_geometry(&self) -> Result<Geometry> {
        self.geometry((self.camera.width, self.camera.height))
    }

    /// Whether it has labels or a mask that may belong to a turned copy of the photo in `file`, which sizes alone do not show.
    pub fn may_be_turned(&self, file: &ImageFile) -> bool {
        self.maps().next().is_some() && file.turns_without_trace()
    }

    /// Its raw labels, which lie at `path`.
    pub fn raw_file<'a>(&'a self, path: &'a Path) -> RawFile<'a> {
        RawFile {
            name: &self.name,
            photo: &self.image,
            path,
            is_labelme: self.drawn.is_some(),
        }
    }

    /// The files of its labels and mask.
    pub fn maps(&self) -> impl Iterator<Item = &PathBuf> {
        let maps = [&self.truth, &self.raw, &self.instances, &self.mask];
        maps.into_iter().flatten()
    }
}

/// A path without components that lead out of a folder.
pub(crate) fn below(path: &Path) -> PathBuf {
    let parts = path.components();
    parts
        .filter(|part| matches!(part, Component::Normal(_)))
        .collect()
}

/// A photo's path without its extension, folders joined by `_`: the name of its view where photos of several folders
/// have the same file names.
pub(crate) fn joined_name(photo: &Path) -> String {
    let path = below(&photo.with_extension(""));
    let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
    parts.join("_")
}

/// The size to which a photo is reduced so that no side is longer than `most` pixels; `None` if it stays as it is. A `most` of
/// 0 means no limit.
pub(crate) fn reduced((width, height): (usize, usize), most: usize) -> Option<(usize, usize)> {
    let longer = width.max(height);
    let side = |length: usize| ((length * most) as f64 / longer as f64).round().max(1.0) as usize;
    (most > 0 && longer > most).then(|| (side(width), side(height)))
}

impl Geometry {
    /// Reduces the photo so that no side is longer than `most` pixels; 0 means no limit.
    pub fn limited_to(mut self, most: usize) -> Self {
        self.preprocessing.size = reduced((self.camera.width, self.camera.height), most);
        self
    }

    /// The camera of the view, after reduction.
    pub fn view_camera(&self) -> Camera {
        match self.preprocessing.size {
            Some((width, height)) => self.camera.resized(width, height),
            None => self.camera.clone(),
        }
    }

    /// The photo of the view.
    pub fn photo(&self, file: &ImageFile) -> Result<RgbImage> {
        Ok(self.preprocessing.decode(file)?.0)
    }

    /// Whether `size` is that of the reduced photo. Label maps of this size were made of the loaded scene, unless a file
    /// beside them says otherwise.
    pub fn is_reduced_size(&self, size: (usize, usize)) -> bool {
        self.preprocessing.size == Some(size)
    }

    /// A label map of any size, as the view's camera sees it. `declared` is the geometry that a file beside it states.
    pub fn labels(&self, map: LabelMap, declared: Option<MapGeometry>) -> LabelMap {
        match declared {
            Some(MapGeometry::Undistorted) => self.resized(map),
            None if self.is_reduced_size((map.width, map.height)) => map,
            None | Some(MapGeometry::Photos) => self.labels_of_photo(map),
        }
    }

    /// How the view lies on its photo, or on maps of the undistorted one where a file beside the maps `declared` them so.
    pub fn placement(&self, declared: Option<MapGeometry>) -> Placement {
        let view = self.view_camera();
        let of_photo = declared != Some(MapGeometry::Undistorted);
        let undistortion = self.preprocessing.undistortion.clone();
        Placement {
            view: [view.width, view.height],
            photo: [self.camera.width, self.camera.height],
            undistortion: undistortion.filter(|_| of_photo).map(Arc::new),
        }
    }

    /// A map of the photo as stored, in any size, as the view's camera sees it.
    pub fn labels_of_photo(&self, map: LabelMap) -> LabelMap {
        self.resized(match &self.preprocessing.undistortion {
            Some(undistortion) => undistortion.labels(&map),
            None => map,
        })
    }

    fn resized(&self, map: LabelMap) -> LabelMap {
        let camera = self.view_camera();
        map.resized(camera.width, camera.height)
    }
}
