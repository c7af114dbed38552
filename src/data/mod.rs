//! Scenes: posed images, label maps, class tables, initial points; dataset formats; the built-in procedural scene.

pub(crate) mod bilinear;
pub mod mask;

pub mod blocks;
pub mod builtin;
pub(crate) mod diagnostics;
pub mod formats;
pub mod labels;
mod options;
mod outputs;
pub mod photos;
mod view_cache;
mod view_photos;

pub use self::diagnostics::check::{Checked, check};
pub use self::diagnostics::info::{CameraBox, ClassShare, Info, Thumbnail, info, thumbnails};
pub use self::formats::camera_file::{read_cameras, read_cameras_moved};
pub use self::formats::folder::scene_name;
pub use self::formats::layout::locate;
pub use self::formats::points::Points;
pub use self::labels::classes::{Class, Classes, ObjectOf};
pub use self::labels::label_map::LabelMap;
pub use self::labels::label_runs::LabelRuns;
pub(crate) use self::labels::largest::{first_largest, winner};
pub use self::labels::map_geometry::MapGeometry;
pub use self::labels::palette::class_color;
pub use self::labels::scores::{LabelProbabilities, ScoreGrid, ScoreMap, ViewScores};
pub use self::options::LoadOptions;
pub use self::outputs::{check_output_file, check_outputs};
pub use self::photos::photo::Photo;
pub(crate) use self::view_cache::ViewCache;
pub use self::view_photos::{ViewPhoto, view_photos};

use self::diagnostics::{notices, poses};
use self::formats::listing;
use self::mask::Mask;
use crate::config::display_as_serialized;
use crate::error::{Result, bail, ensure};
use crate::files::file_name;
use crate::splat::camera::Camera;
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::Path;

/// Loads the scene in folder `dir`, in the layout that the options name or that the folder has.
///
/// The origin is the mean of all camera centres, subtracted in f64 from cameras and points. Lens distortion is taken out of photos
/// and label maps. Photos are decoded in parallel and kept in memory up to [`LoadOptions::decoded_mb`]. The others are decoded
/// again at each use; their files must not change. Warnings name what is left out. They also name what loads but is seldom
/// intended, such as poses in another convention.
///
/// # Errors
/// [`crate::Error::Missing`], [`crate::Error::Input`], [`crate::Error::Io`] or [`crate::Error::Limit`] naming file and
/// field: malformed, missing or damaged files, sizes that disagree, poses that are not rotations, camera models that are
/// no pinhole after undistortion, unknown label ids, repeated names, no training view.
pub fn load(dir: &Path, options: &LoadOptions) -> Result<Scene> {
    let listing = notices::list_sound(dir, options)?;
    let warn = |notice: &String| tracing::warn!("{}: {notice}", dir.display());
    listing.notices.iter().for_each(warn);
    if let Some(fault) = &listing.no_label_file {
        tracing::warn!("{fault}");
    }
    let (scene, turned) = listing.load(dir, options)?;
    listing.raw.unmatched_classes().iter().for_each(warn);
    notices::turned(listing.frames.iter().zip(turned))
        .iter()
        .for_each(warn);
    if scene.points.is_empty() {
        notices::empty_cloud(&listing.cloud).iter().for_each(warn);
    }
    notices::scene(&scene, listing.unlabelled())
        .iter()
        .for_each(warn);
    // Points of depth images lie where the poses put them.
    if !matches!(listing.cloud, listing::Cloud::Depth(_)) {
        // The views of a sound listing are its frames.
        let photo = |i: usize| {
            let view: &View = &scene.views[i];
            Some((view.camera.moved(scene.origin), view.image.pixels().ok()?))
        };
        match poses::of_listing(&listing, &scene.points, photo) {
            Some(poses::Verdict::Misread(fault)) => tracing::warn!("{fault}"),
            Some(poses::Verdict::Unrelated(notice)) => tracing::warn!("{notice}"),
            None => {}
        }
    }
    Ok(scene)
}

/// The cameras of the scene in folder `dir`, in any layout, in the order of its views. They are pinholes, as [`load`] makes them of
/// distorted photos, in world units. Subtract a scene's origin before rendering. `split` keeps only those frames. Photos may be
/// missing where their sizes are known without them.
///
/// # Errors
/// As [`load`]; also when no frame is left.
pub fn load_cameras(
    dir: &Path,
    options: &LoadOptions,
    split: Option<Split>,
) -> Result<Vec<NamedCamera>> {
    let listing = notices::list_sound(dir, options)?;
    let mut cameras = Vec::new();
    for frame in &listing.frames {
        if split.is_some_and(|split| split != frame.split) {
            continue;
        }
        let geometry = if frame.resizable {
            frame.open(&listing.file)?.1
        } else {
            frame.own_geometry()?
        };
        cameras.push(NamedCamera {
            name: frame.name.clone(),
            split: frame.split,
            camera: geometry.limited_to(options.max_side).view_camera(),
        });
    }
    if cameras.is_empty() {
        let of_split = split.map_or(String::new(), |split| format!(" of split {split}"));
        bail!(&listing.file, "frames"; found "no frame{of_split}"; expected "at least one";
            help "choose the other split or all");
    }
    Ok(cameras)
}

/// A camera with the name of its frame.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name of the view.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// Pose and intrinsics, world units.
    pub camera: Camera,
}

/// A scene as loaded: everything centred on [`Scene::origin`].
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Name for reports.
    pub name: String,
    /// All views, in file order.
    pub views: Vec<View>,
    /// Class table; empty for scenes without labels.
    pub classes: Classes,
    /// Initial cloud, relative to [`Scene::origin`].
    pub points: Points,
    /// Whether the raw labels are shapes that somebody drew (LabelMe, COCO instances, CVAT).
    pub drawn: bool,
    /// The offset that was subtracted from every world position (f64); exports add it back.
    pub origin: DVec3,
    /// World direction that points up, unit length.
    pub up: DVec3,
    /// The assumed size of a world unit.
    pub unit: WorldUnit,
}

/// What the layout says of the size of a world unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum WorldUnit {
    /// A metre.
    #[default]
    Metre,
    /// Arbitrary, as in a COLMAP model.
    Arbitrary {
        /// The largest distance of a camera from the mean of all, world units. A block has that of the whole scene.
        extent: f64,
    },
}

impl Scene {
    /// The same scene relative to another origin, such as that of Gaussians made elsewhere.
    #[must_use]
    pub fn with_origin(mut self, origin: DVec3) -> Self {
        let shift = self.origin - origin;
        self.views
            .iter_mut()
            .for_each(|view| view.camera.center += shift);
        crate::splat::shift(&mut self.points.positions, shift);
        Self { origin, ..self }
    }

    /// Training views with raw labels, in file order.
    pub fn labelled(&self) -> impl Iterator<Item = &View> {
        self.split(Split::Train).filter(|view| view.raw.is_some())
    }

    /// Leaves out the classes that no label of a view names, and that `kept` does not have: each would cost every Gaussian a score.
    /// A scene whose labels name no class keeps all, as does one with scores, which may name classes that label maps do not.
    pub fn drop_unused_classes(&mut self, kept: &Classes) {
        if self.views.iter().any(|view| view.scores.is_some()) {
            return;
        }
        let maps = self.views.iter().flat_map(|view| [&view.raw, &view.truth]);
        let named: BTreeSet<u16> = maps
            .flatten()
            .flat_map(|map| map.runs().map(|(id, _)| id))
            .collect();
        let is_used = |class: &Class| named.contains(&class.id) || kept.index(class.id).is_some();
        if self.classes.entries.iter().any(is_used) {
            self.classes.entries.retain(is_used);
        }
    }

    /// Refuses a scene without training views.
    pub(crate) fn expect_training_views(&self) -> Result<()> {
        ensure!(self.split(Split::Train).next().is_some(),
            argument "data"; found "{} without training views", self.name;
            expected "a scene with training views"; help "mark some views as `train`");
        Ok(())
    }

    /// The camera of every view in world units, in file order.
    pub fn cameras(&self) -> Vec<NamedCamera> {
        let named = |view: &View| NamedCamera {
            name: view.name.clone(),
            split: view.split,
            camera: view.camera.moved(self.origin),
        };
        self.views.iter().map(named).collect()
    }

    /// [`Scene::up`] where the files say it; elsewhere cameras tell better.
    pub fn known_up(&self) -> Option<DVec3> {
        Some(self.up).filter(|up| *up == DVec3::Z)
    }

    /// Views of one split, in file order.
    pub fn split(&self, split: Split) -> impl Iterator<Item = &View> {
        self.views.iter().filter(move |v| v.split == split)
    }
}

/// Which use a view is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Trained on.
    Train,
    /// Held out.
    Test,
}

display_as_serialized!(Split);

/// One posed photo with its labels.
#[derive(Clone, Debug)]
pub struct View {
    /// File stem, unique within the scene.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// Pose and intrinsics, centre relative to [`Scene::origin`].
    pub camera: Camera,
    /// The photo, 8-bit sRGB.
    pub image: Photo,
    /// The used pixels, where some are left out. Left-out pixels are not trained on, not scored, and unlabelled in the maps below.
    pub mask: Option<Mask>,
    /// True labels, where known. Only for scoring.
    pub truth: Option<LabelRuns>,
    /// Raw labels of a 2D segmenter, where given. In test views they only score the 2D baseline.
    pub raw: Option<LabelRuns>,
    /// Where the class probabilities of [`View::raw`] are, if the segmenter's scores lie beside the map.
    pub scores: Option<ViewScores>,
    /// Labels that a person corrected in a finished run, the ignored id elsewhere. They take precedence over the raw labels in
    /// training.
    pub corrected: Option<LabelRuns>,
    /// The known segments of [`View::raw`], where its ids are segments of this view, not classes.
    pub segments: Vec<Segment>,
    /// True instance ids, where known; 0 is none. Only for scoring.
    pub instances: Option<LabelRuns>,
}

/// A segment of one view; its id says nothing about other views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// Id in the view's raw labels.
    pub id: u16,
    /// Class id, where the segmenter gives one.
    pub class: Option<u16>,
    /// Whether it is a thing, which can be counted, and not stuff such as floor.
    pub thing: bool,
}

impl View {
    /// The file name of the photo, or the name of the view where it lies in no file.
    pub fn file_name(&self) -> String {
        let name = self.image.file().and_then(file_name);
        name.unwrap_or_else(|| self.name.clone())
    }

    /// The photo as `[H, W, 3]` row-major sRGB in 0..1.
    ///
    /// # Errors
    /// As [`Photo::pixels`].
    pub fn rgb(&self) -> Result<Vec<f32>> {
        let photo = self.image.pixels()?;
        let values = photo.as_raw().iter();
        Ok(values.map(|&v| f32::from(v) / 255.0).collect())
    }

    /// Refuses a mask of a different size than the photo.
    pub(crate) fn check_mask(&self) -> Result<()> {
        let (width, height) = (self.image.width(), self.image.height());
        self.mask
            .iter()
            .try_for_each(|mask| mask.expect_size(&format!("view {}", self.name), width, height))
    }
}

/// Names that a notice lists.
const NAMES: usize = 3;

/// The first few names, and how many more there are.
pub(crate) fn first_names(names: &[impl AsRef<str>]) -> String {
    let first: Vec<&str> = names.iter().take(NAMES).map(AsRef::as_ref).collect();
    match names.len() - first.len() {
        0 => first.join(", "),
        more => format!("{} and {more} more", first.join(", ")),
    }
}
