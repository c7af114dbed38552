//! The contents of a scene folder of any layout before photos are decoded, and the scene made from them.

use super::colmap;
use super::depth::Depth;
use super::frame::Frame;
use super::frame_labels::FrameLabels;
use super::label_folder::choose_raw_files;
use super::points::MAX_STRAY;
use crate::config::Layout;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::raw::{self, RawFile, RawLabels};
use crate::data::{
    Classes, LabelRuns, Limits, LoadOptions, Photo, PhotoCache, Points, Scene, Split, View,
};
use crate::error::{Error, Result, ensure, invalid};
use crate::files::file_name;
use crate::splat::camera::{Camera, level_up, spread};
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A scene folder, and how it is read.
#[derive(Clone, Copy)]
pub(crate) struct Folder<'a> {
    pub dir: &'a Path,
    pub options: &'a LoadOptions,
    /// Never `auto`.
    pub layout: Layout,
}

/// The frames of a folder and everything known about them.
pub(crate) struct Listing {
    /// How the folder is laid out; never `auto`.
    pub layout: Layout,
    /// The file that lists the frames, for messages.
    pub file: PathBuf,
    /// The frames that are read, in file order or by name.
    pub frames: Vec<Frame>,
    /// Class table; empty without labels, and where it could not be read.
    pub classes: Classes,
    /// The class table is that of a whole dataset: only classes that occur in the scene are kept.
    pub occurring_classes: bool,
    /// Class id of each id in the true labels, where they hold ids of another table; [`UNMAPPED`] where there is none.
    /// Length 65536.
    pub truth_ids: Option<Vec<u32>>,
    /// How the raw labels are stored.
    pub raw: RawLabels,
    /// Which cameras the label maps belong to, where their folders say so.
    pub geometries: MapGeometries,
    /// Label maps of another size than their photos are resampled.
    pub resample_labels: bool,
    /// The initial cloud.
    pub cloud: Cloud,
    /// Whether +z is up in the world; else the cameras tell.
    pub z_up: bool,
    /// Sentences on what is left out or assumed.
    pub notices: Vec<String>,
}

/// An id of true labels without a class id.
pub(crate) const UNMAPPED: u32 = u32::MAX;

/// Where the initial cloud comes from.
pub(crate) enum Cloud {
    None,
    /// A PLY file.
    Ply(PathBuf),
    /// `points3D` of a COLMAP model.
    Colmap(PathBuf),
    /// Depth images.
    Depth(Depth),
}

/// Faults collected while the rest of a folder is checked.
#[derive(Default)]
pub(crate) struct Problems(Vec<Error>);

impl Problems {
    pub fn push(&mut self, error: Error) {
        self.0.push(error);
    }

    /// The value, if there is one. An error is recorded.
    pub fn ok<T>(&mut self, result: Result<T>) -> Option<T> {
        result.map_err(|error| self.push(error)).ok()
    }

    /// # Errors
    /// The first fault.
    pub fn first(self) -> Result<()> {
        self.0.into_iter().next().map_or(Ok(()), Err)
    }

    pub fn messages(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(ToString::to_string)
    }

    pub fn all(self) -> Vec<Error> {
        self.0
    }
}

impl Listing {
    /// A listing without a cloud. Its class table is the folder's. Where labels need one and the folder has none, it is the table
    /// of the `dataset`. Raw labels are added by [`Listing::with_raw_labels`].
    pub fn new(
        folder: Folder<'_>,
        file: PathBuf,
        mut frames: Vec<Frame>,
        dataset: Option<Classes>,
        problems: &mut Problems,
    ) -> Self {
        let Folder { dir, options, .. } = folder;
        choose_raw_files(dir, options, &mut frames);
        let labelled = if frames.iter().any(|frame| frame.truth.is_some()) {
            Some("")
        } else {
            raw::needs_classes(dir, options, &raw_files(&frames))
        };
        let own = dir.join("classes.json").is_file();
        let dataset = dataset.filter(|_| labelled.is_some() && !own);
        let occurring_classes = dataset.is_some();
        let classes = dataset.map_or_else(|| read_classes(dir, labelled), Ok);
        Self {
            layout: folder.layout,
            file,
            frames,
            classes: problems.ok(classes).unwrap_or_default(),
            occurring_classes,
            truth_ids: None,
            raw: RawLabels::grey(),
            geometries: MapGeometries::default(),
            resample_labels: false,
            cloud: Cloud::None,
            z_up: false,
            notices: Vec::new(),
        }
    }

    /// Determines how the raw labels are stored. If that fails, a fault is recorded and they are left out.
    pub fn with_raw_labels(
        mut self,
        dir: &Path,
        options: &LoadOptions,
        problems: &mut Problems,
    ) -> Self {
        let detected = RawLabels::detect(dir, options, &raw_files(&self.frames), &self.classes);
        match problems.ok(detected) {
            Some((raw, vocabulary)) => {
                // One file may hold the shapes of all photos.
                let is_empty =
                    |frame: &&mut Frame| raw.are_drawn() && !raw.has_drawing(&frame.name);
                let without = self.frames.iter_mut().filter(is_empty);
                without.for_each(|frame| frame.raw = None);
                self.raw = raw;
                if let Some(vocabulary) = vocabulary {
                    self.occurring_classes |= self.classes.is_empty();
                    self.classes = vocabulary.classes;
                    self.notices.extend(vocabulary.notice);
                }
            }
            None => self.frames.iter_mut().for_each(|frame| frame.raw = None),
        }
        self
    }

    /// Refuses a listing without training views, or with more views than the limits allow.
    pub fn check_sizes(&self, limits: &Limits) -> Result<()> {
        let views = self.frames.len();
        limits.check_views(&self.file, views)?;
        ensure!(self.frames.iter().any(|frame| frame.split == Split::Train),
            &self.file, "frames"; found "{views} test frames"; expected "at least one training view";
            help "mark frames \"train\", or use more of them");
        Ok(())
    }

    /// The id of pixels without a raw label.
    pub fn unlabelled(&self) -> u16 {
        if self.raw.are_segments() {
            0
        } else {
            self.classes.ignore
        }
    }

    /// The cloud, relative to `origin`, without its strays.
    pub fn points(&self, origin: DVec3, limits: &Limits) -> Result<Points> {
        let mut points = match &self.cloud {
            Cloud::None => Points::default(),
            Cloud::Ply(path) => Points::read(path, origin, limits)?,
            Cloud::Colmap(path) => colmap::read_points(path, origin, limits)?,
            Cloud::Depth(depth) => depth.points(&self.frames, &self.file, origin, limits)?,
        };
        let left_out = points.remove_strays();
        if left_out > 0 {
            tracing::warn!(
                "{}: {left_out} points of the initial cloud are left out: they lie {MAX_STRAY} times as far out as half of all points",
                self.file.display()
            );
        }
        Ok(points)
    }

    /// Mean of the camera centres.
    pub fn origin(&self) -> DVec3 {
        self.spread().0
    }

    /// Mean of the camera centres, and the largest distance from it.
    pub fn spread(&self) -> (DVec3, f64) {
        spread(self.frames.iter().map(|frame| frame.camera.center))
    }

    /// World direction that points up.
    fn up(&self) -> DVec3 {
        if self.z_up {
            return DVec3::Z;
        }
        let cameras: Vec<Camera> = self
            .frames
            .iter()
            .map(|frame| frame.camera.clone())
            .collect();
        level_up(&cameras)
    }

    /// Decodes everything, a few files at a time. The second value says for each frame whether its labels may belong to a
    /// turned photo.
    pub fn load(&self, dir: &Path, options: &LoadOptions) -> Result<(Scene, Vec<bool>)> {
        self.check_sizes(&options.limits)?;
        let cache = Arc::new(PhotoCache::new(options.decoded_mb.saturating_mul(1 << 20)));
        let origin = self.origin();
        let known = self.classes.lookup();
        let views = self
            .frames
            .par_iter()
            .map(|frame| self.view(frame, options, origin, &known, &cache));
        let (views, turned): (Vec<View>, Vec<bool>) = in_order(views)?.into_iter().unzip();
        let scene = Scene {
            name: scene_name(dir),
            classes: self.classes_of(&views),
            views,
            points: self.points(origin, &options.limits)?,
            drawn: self.raw.are_drawn(),
            origin,
            up: self.up(),
        };
        Ok((scene, turned))
    }

    /// The view of a frame, and whether its labels may belong to a turned photo.
    fn view(
        &self,
        frame: &Frame,
        options: &LoadOptions,
        origin: DVec3,
        known: &[u16],
        cache: &Arc<PhotoCache>,
    ) -> Result<(View, bool)> {
        let (file, labels) = FrameLabels::open(self, frame, known, options)?;
        let preprocessing = labels.geometry.preprocessing().over(options.background);
        let image = Photo::in_file(&file, preprocessing, &options.limits, cache)?;
        let truth = labels.truth()?.map(LabelRuns::from);
        let raw = labels.raw()?;
        let scores = labels.scores();
        let (raw, segments) = raw.map_or((None, Vec::new()), |r| (Some(r.map.into()), r.segments));
        let instances = labels.instances()?.map(LabelRuns::from);
        let camera = labels.geometry.view_camera().moved(-origin);
        let view = View {
            name: frame.name.clone(),
            split: frame.split,
            camera,
            image,
            mask: labels.mask,
            truth,
            raw,
            scores,
            segments,
            instances,
        };
        Ok((view, frame.may_be_turned(&file)))
    }

    /// The classes of the scene. Of a table for a whole dataset, only classes that occur in some view.
    fn classes_of(&self, views: &[View]) -> Classes {
        let mut classes = self.classes.clone();
        if self.occurring_classes {
            let mut occurs = vec![false; 1 << 16];
            for view in views {
                let raw = view.raw.iter().filter(|_| !self.raw.are_segments());
                let ids = view
                    .truth
                    .iter()
                    .chain(raw)
                    .flat_map(LabelRuns::runs)
                    .map(|(id, _)| id);
                let segments = view.segments.iter().filter_map(|segment| segment.class);
                ids.chain(segments)
                    .for_each(|id| occurs[usize::from(id)] = true);
            }
            classes
                .entries
                .retain(|class| occurs[usize::from(class.id)]);
        }
        classes
    }
}

/// The raw labels of the frames that have some.
fn raw_files(frames: &[Frame]) -> Vec<RawFile<'_>> {
    let labelled = frames
        .iter()
        .filter_map(|frame| Some((frame, frame.raw.as_deref()?)));
    let files = labelled.map(|(frame, path)| RawFile {
        name: &frame.name,
        photo: &frame.image,
        path,
        is_labelme: frame.drawn.is_some(),
    });
    files.collect()
}

/// The name of the scene in the folder `dir`: that of the folder.
pub fn scene_name(dir: &Path) -> String {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    file_name(&full).unwrap_or_else(|| "scene".into())
}

/// All results, or the first error in frame order, whichever thread met one first.
pub(crate) fn in_order<T: Send>(
    results: impl IndexedParallelIterator<Item = Result<T>>,
) -> Result<Vec<T>> {
    let mut all = Vec::new();
    results.collect_into_vec(&mut all);
    all.into_iter().collect()
}

/// `classes.json` of a scene folder. Only scenes without labels may lack it; for others, `labelled` is added to the help.
fn read_classes(dir: &Path, labelled: Option<&str>) -> Result<Classes> {
    let path = dir.join("classes.json");
    match labelled {
        _ if path.is_file() => {
            let classes = Classes::read(&path)?;
            ensure!(!classes.is_empty(), &path, "classes"; found "no class"; expected "one or more";
                help "list the classes: {{\"0\": \"void\", \"1\": \"wall\", ..}}, or remove the file");
            Ok(classes)
        }
        None => Ok(Classes::default()),
        Some(or) => Err(
            invalid!(&path, "file"; found "nothing"; expected "a class table, as frames have labels";
            help "list the classes: {{\"0\": \"void\", \"1\": \"wall\", ..}}{or}"),
        ),
    }
}
