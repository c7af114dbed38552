//! What a scene folder says before any photo is decoded, whatever its layout, and the scene that follows from it.

use super::colmap;
use super::depth::Depth;
use super::frame::{Frame, Geometry, joined_name, proportional};
use crate::config::Layout;
use crate::data::diagnostics::cautions;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::raw::{RawLabels, RawMap};
use crate::data::mask::Mask;
use crate::data::photos::image_file::ImageFile;
use crate::data::{
    Classes, LabelMap, LabelRuns, Limits, LoadOptions, Photo, PhotoCache, Points, Scene, Split,
    View,
};
use crate::error::{Error, Result};
use crate::splat::camera::{Camera, level_up};
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The frames of a folder with all that is known of them.
pub(crate) struct Listing {
    /// How the folder is laid out; never `auto`.
    pub layout: Layout,
    /// The file that lists the frames, for messages.
    pub file: PathBuf,
    /// Those that are read, in file order or by name.
    pub frames: Vec<Frame>,
    /// Class table; empty without labels, and where it could not be read.
    pub classes: Classes,
    /// Of the class table, which is that of a whole dataset, only classes that occur in the scene are kept.
    pub occurring_classes: bool,
    /// Class id of each id in the true labels, where they hold others; [`UNMAPPED`] where there is none. Length 65536.
    pub truth_ids: Option<Vec<u32>>,
    /// How the raw labels are stored.
    pub raw: RawLabels,
    /// What label maps are of, where their folders say so.
    pub geometries: MapGeometries,
    /// Label maps of another size than their photos are resampled.
    pub resample_labels: bool,
    /// The initial cloud.
    pub cloud: Cloud,
    /// Whether +z is up in the world; else the cameras tell.
    pub z_up: bool,
    /// What was left out or taken for granted, in sentences.
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
    /// What depth images show.
    Depth(Depth),
}

impl Cloud {
    /// For layouts that name no cloud: `points.ply` in the scene folder, else the depth images of `frames`, which
    /// `file` gives.
    pub fn of_sequence(
        dir: &Path,
        frames: &[Frame],
        scale: f64,
        file: impl Fn(&Frame) -> PathBuf,
    ) -> Self {
        let path = dir.join("points.ply");
        if path.is_file() {
            return Self::Ply(path);
        }
        let files: Vec<_> = frames
            .iter()
            .map(|frame| Some(file(frame)).filter(|file| file.is_file()))
            .collect();
        if files.iter().all(Option::is_none) {
            Self::None
        } else {
            Self::Depth(Depth { files, scale })
        }
    }
}

/// Faults that do not keep the rest of a folder from being looked at.
#[derive(Default)]
pub(crate) struct Problems(Vec<Error>);

impl Problems {
    pub fn push(&mut self, error: Error) {
        self.0.push(error);
    }

    /// The value, or nothing and a fault more.
    pub fn keep<T>(&mut self, result: Result<T>) -> Option<T> {
        result.map_err(|error| self.push(error)).ok()
    }

    /// # Errors
    /// The first fault.
    pub fn none(self) -> Result<()> {
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
    /// Settles how the raw labels are stored. Where that fails they are left out, which is a fault.
    pub fn with_raw_labels(
        mut self,
        dir: &Path,
        options: &LoadOptions,
        problems: &mut Problems,
    ) -> Self {
        let settled = RawLabels::settle(
            dir,
            options,
            &self.frames,
            &mut self.classes,
            &mut self.notices,
        );
        match problems.keep(settled) {
            Some((raw, own)) => {
                self.raw = raw;
                self.occurring_classes |= own;
            }
            None => self.frames.iter_mut().for_each(|frame| frame.raw = None),
        }
        self
    }

    /// Refuses a listing without training views, or of more than the limits allow.
    pub fn check_sizes(&self, limits: &Limits) -> Result<()> {
        let views = self.frames.len() as u64;
        let what = format!("{}: frames", self.file.display());
        Limits::check(
            what,
            views,
            limits.views as u64,
            "thin out with data.stride or data.max_frames",
        )?;
        if !self.frames.iter().any(|frame| frame.split == Split::Train) {
            let found = format!("{views} test frames");
            let help = "mark frames \"train\", or use more of them";
            return Err(Error::input(
                &self.file,
                "frames",
                found,
                "at least one training view",
                help,
            ));
        }
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

    /// The cloud, relative to `origin`.
    pub fn points(&self, origin: DVec3, limits: &Limits) -> Result<Points> {
        match &self.cloud {
            Cloud::None => Ok(Points::default()),
            Cloud::Ply(path) => Points::read(path, origin, limits),
            Cloud::Colmap(path) => colmap::read_points(path, origin, limits),
            Cloud::Depth(depth) => depth.points(&self.frames, &self.file, origin, limits),
        }
    }

    /// Mean of the camera centres.
    pub fn origin(&self) -> DVec3 {
        self.frames.iter().map(|f| f.camera.center).sum::<DVec3>() / self.frames.len().max(1) as f64
    }

    /// World direction that points up.
    fn up(&self) -> DVec3 {
        if self.z_up {
            return DVec3::Z;
        }
        level_up(
            &self
                .frames
                .iter()
                .map(|frame| frame.camera.clone())
                .collect::<Vec<_>>(),
        )
    }

    /// Decodes everything, a few files at a time. With the scene comes what the photos' files said beside their pixels.
    pub fn load(&self, dir: &Path, options: &LoadOptions) -> Result<(Scene, Option<String>)> {
        let limits = &options.limits;
        self.check_sizes(limits)?;
        let cache = Arc::new(PhotoCache::new(options.decoded_mb.saturating_mul(1 << 20)));
        let (origin, up) = (self.origin(), self.up());
        let known = self.classes.lookup();
        let read = in_order(self.frames.par_iter().map(|frame| {
            let (file, geometry) = frame.open(&self.file, limits)?;
            let geometry = geometry.within(options.max_side);
            let image = Photo::in_file(
                &file,
                geometry.development().over(options.background),
                limits,
                &cache,
            )?;
            let mask = frame.read_mask(&geometry, limits)?;
            let (known, geometry) = (&known, &geometry);
            let maps = Maps {
                listing: self,
                frame,
                geometry,
                known,
                limits,
                mask: mask.as_ref(),
            };
            let truth = maps.truth()?.map(LabelRuns::from);
            let raw = maps.raw()?;
            let (raw, segments) =
                raw.map_or((None, Vec::new()), |r| (Some(r.map.into()), r.segments));
            let instances = maps.instances()?.map(LabelRuns::from);
            let camera = geometry.seen();
            let camera = Camera {
                center: camera.center - origin,
                ..camera
            };
            let (name, split) = (frame.name.clone(), frame.split);
            let view = View {
                name,
                split,
                camera,
                image,
                mask,
                truth,
                raw,
                segments,
                instances,
            };
            Ok((view, frame.is_turned_unseen(&file)))
        }))?;
        let (views, turned): (Vec<View>, Vec<bool>) = read.into_iter().unzip();
        let turned = cautions::turned(self.frames.iter().zip(turned));
        let points = self.points(origin, limits)?;
        let mut classes = self.classes.clone();
        if self.occurring_classes {
            let mut occurs = vec![false; 1 << 16];
            let of_classes = !self.raw.are_segments();
            let maps = views.iter().flat_map(|view| {
                view.truth
                    .iter()
                    .chain(view.raw.iter().filter(|_| of_classes))
            });
            maps.flat_map(LabelRuns::runs)
                .for_each(|(id, _)| occurs[usize::from(id)] = true);
            let told = views
                .iter()
                .flat_map(|view| &view.segments)
                .filter_map(|segment| segment.class);
            told.for_each(|id| occurs[usize::from(id)] = true);
            classes
                .entries
                .retain(|class| occurs[usize::from(class.id)]);
        }
        Ok((
            Scene {
                name: scene_name(dir),
                views,
                classes,
                points,
                origin,
                up,
            },
            turned,
        ))
    }
}

/// What the label maps of a frame are read with.
#[derive(Clone, Copy)]
pub(crate) struct Maps<'a> {
    pub listing: &'a Listing,
    pub frame: &'a Frame,
    pub geometry: &'a Geometry,
    /// [`Classes::lookup`] of the listing's classes.
    pub known: &'a [u16],
    pub limits: &'a Limits,
    /// Maps are unlabelled where it leaves pixels out.
    pub mask: Option<&'a Mask>,
}

impl Maps<'_> {
    /// The true labels as the view's camera sees them, in class ids.
    pub fn truth(&self) -> Result<Option<LabelMap>> {
        let Self {
            listing,
            known,
            mask,
            ..
        } = *self;
        let Some(path) = &self.frame.truth else {
            return Ok(None);
        };
        let mut map = self.grey(path)?;
        if let Some(ids) = &listing.truth_ids {
            map.translate(path, ids)?;
        }
        map.settle_ids(path, &listing.classes, known, "")?;
        Ok(Some(
            self.seen(path, map).without(mask, listing.classes.ignore),
        ))
    }

    /// The true instances as the view's camera sees them.
    pub fn instances(&self) -> Result<Option<LabelMap>> {
        let Some(path) = &self.frame.instances else {
            return Ok(None);
        };
        Ok(Some(
            self.seen(path, self.grey(path)?).without(self.mask, 0),
        ))
    }

    /// The raw labels as the view's camera sees them.
    pub fn raw(&self) -> Result<Option<RawMap>> {
        let Self {
            listing,
            geometry,
            known,
            limits,
            mask,
            ..
        } = *self;
        let Some(path) = &self.frame.raw else {
            return Ok(None);
        };
        let check = |file: &ImageFile| self.check_size(path, file);
        let photo = (geometry.camera.width, geometry.camera.height);
        let raw = listing
            .raw
            .read(path, photo, &listing.classes, known, limits, &check)?;
        Ok(Some(RawMap {
            map: self.seen(path, raw.map).without(mask, listing.unlabelled()),
            ..raw
        }))
    }

    /// A grey label map of the size of its file.
    fn grey(&self, path: &Path) -> Result<LabelMap> {
        expect_file(path)?;
        let file = ImageFile::open(path, self.limits)?;
        self.check_size(path, &file)?;
        LabelMap::decode(path, &file)
    }

    /// The map that was read from `path` as the view's camera sees it.
    fn seen(&self, path: &Path, map: LabelMap) -> LabelMap {
        self.geometry.labels(map, self.listing.geometries.of(path))
    }

    /// Refuses a file of the labels at `path` that has another size than its photo, as that lies there or as it is used, or,
    /// where maps are resampled, other proportions.
    fn check_size(&self, path: &Path, file: &ImageFile) -> Result<()> {
        let Self {
            listing,
            frame,
            geometry,
            ..
        } = *self;
        let said = listing.geometries.of(path).is_some();
        if !said && geometry.is_as_seen(file.size) {
            return Ok(());
        }
        let (w, h) = (geometry.camera.width, geometry.camera.height);
        let resampled = said || listing.resample_labels || frame.scales;
        match resampled && proportional(file.size, (w, h)) {
            true => Ok(()),
            false => {
                let photo = || {
                    ImageFile::open(&frame.image, self.limits)
                        .ok()?
                        .exif_orientation()
                };
                let whose = match file.lies_across(w, h).then(photo).flatten() {
                    Some(exif) => {
                        format!("its photo as it is stored, whose EXIF orientation is {exif}")
                    }
                    None => "its photo".to_owned(),
                };
                file.expect_size(w, h, &whose)
            }
        }
    }
}

/// Refuses a label map that is not there.
pub(crate) fn expect_file(path: &Path) -> Result<()> {
    if path.is_file() {
        return Ok(());
    }
    let help = "put the label map there, or do not name it".into();
    Err(Error::Missing {
        what: "file",
        path: path.to_owned(),
        help,
    })
}

pub(crate) fn scene_name(dir: &Path) -> String {
    let full = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    full.file_name()
        .map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
}

/// All results, or the first error in frame order, whichever thread met one first.
pub(crate) fn in_order<T: Send>(
    results: impl IndexedParallelIterator<Item = Result<T>>,
) -> Result<Vec<T>> {
    let mut all = Vec::new();
    results.collect_into_vec(&mut all);
    all.into_iter().collect()
}

/// `classes.json` of a scene folder; only scenes without labels may lack it: those that have some are `labelled`, with what
/// else mends that.
pub(crate) fn read_classes(dir: &Path, labelled: Option<&str>) -> Result<Classes> {
    let path = dir.join("classes.json");
    if path.is_file() {
        return Classes::read(&path);
    }
    if let Some(or) = labelled {
        let help = format!("list the classes: {{\"0\": \"void\", \"1\": \"wall\", ..}}{or}");
        return Err(Error::input(
            &path,
            "file",
            "nothing",
            "a class table, as frames have labels",
            help,
        ));
    }
    Ok(Classes::default())
}

/// Label maps of photos in a layout that does not name them: by name in a folder.
pub(crate) struct LabelFolder {
    folder: PathBuf,
    required: bool,
}

impl LabelFolder {
    /// Folder `name` of `dir`, where some photos may lack a map.
    pub fn optional(dir: &Path, name: &str) -> Self {
        Self::in_folder(dir.join(name))
    }

    /// `folder`, where some photos may lack a map.
    pub fn in_folder(folder: PathBuf) -> Self {
        Self {
            folder,
            required: false,
        }
    }

    /// The raw labels: the folder that the user names, where each photo must have a map, or `labels_raw`.
    pub fn raw(dir: &Path, named: Option<&str>) -> Self {
        match named {
            Some(name) => Self {
                folder: dir.join(name),
                required: true,
            },
            None => Self::optional(dir, "labels_raw"),
        }
    }

    /// The map of the photo that lies at `photo` below the folder of photos: the same path with `.png` for its extension or
    /// behind it, the name of its view, or its stem alone; or a folder of masks of one of these names without `.png`.
    pub fn of(&self, photo: &Path) -> Option<PathBuf> {
        let files = self.files(photo);
        let masks = files
            .iter()
            .map(|path| path.with_extension(""))
            .find(|path| path.is_dir());
        let found = files.iter().find(|path| path.is_file()).cloned().or(masks);
        found.or_else(|| files.into_iter().next().filter(|_| self.required))
    }

    /// [`LabelFolder::of`] where a folder of masks is none of the answers.
    pub fn file_of(&self, photo: &Path) -> Option<PathBuf> {
        self.files(photo).into_iter().find(|path| path.is_file())
    }

    /// Files that may be meant, the usual one first.
    fn files(&self, photo: &Path) -> Vec<PathBuf> {
        let usual = self.folder.join(photo).with_extension("png");
        let behind = format!("{}.png", photo.to_string_lossy());
        let of_view = format!("{}.png", joined_name(photo));
        let stem = photo
            .file_stem()
            .map(|stem| format!("{}.png", stem.to_string_lossy()));
        let others = [Some(behind), Some(of_view), stem]
            .into_iter()
            .flatten()
            .map(|name| self.folder.join(name));
        std::iter::once(usual).chain(others).collect()
    }
}
